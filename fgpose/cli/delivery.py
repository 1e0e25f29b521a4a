"""The end of every command that estimates: its result is written, shown and summed up."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from fgpose.cli.findings import conclude
from fgpose.cli.live import wait_for_viewers
from fgpose.cli.options import new_console
from fgpose.cli.tables import print_result
from fgpose.pipeline import Display, OutputError, Outputs, Result, show, write_outputs
from fgpose.pipeline.diagnosed import diagnosed
from fgpose.viewer import Recording

Summary = Callable[[Result, tuple[Path, ...]], None]
"""Prints a summary of a result and the files that it is in."""


def deliver(
    result: Result,
    outputs: Outputs,
    viewer: Recording | None = None,
    display: Display = show,
    summary: Summary | None = None,
    *,
    strict: bool = False,
) -> int:
    """Diagnose a result, write it, show it, print its summary and what is probably wrong; then, if it is live, serve
    the viewers until Ctrl-C.

    Returns:
        The exit code; see conclude.

    Raises:
        ValueError: nothing is determined.
        OutputError: a file could not be written; the others were, and the result has been summed up.
    """
    summary = summary or (lambda result, written: print_result(new_console(), result, written))
    with new_console(stderr=True).status("looking for what may be wrong"):
        result = diagnosed(result, outputs.world_up)
    try:
        written = write_outputs(result, outputs, viewer, display)
    except OutputError as error:
        summary(result, error.written)
        raise
    summary(result, written)
    code = conclude(new_console(), result.diagnosis, strict=strict)
    if viewer is not None:
        wait_for_viewers(outputs)
    return code
