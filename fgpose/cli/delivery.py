"""The end of every command that estimates: its result is written, shown and summed up."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from fgpose.cli.findings import conclude
from fgpose.cli.live import wait_for_viewers
from fgpose.cli.options import new_console
from fgpose.cli.people_tables import print_people
from fgpose.cli.tables import print_result
from fgpose.pipeline import OutputError, Outputs, PeopleResult, Result, show, show_people, write_outputs, write_people
from fgpose.pipeline.diagnosed import AnyResult, diagnosed
from fgpose.viewer import PeopleRecording, Recording

Summary = Callable[[Result, tuple[Path, ...]], None]
"""Prints a summary of a result and the files that it is in."""


def deliver(
    result: Result,
    outputs: Outputs,
    viewer: Recording | None = None,
    display: Callable[[Result, Recording], None] = show,
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
    result = _looked_at(result, outputs)
    _deliver(lambda: write_outputs(result, outputs, viewer, display), lambda written: summary(result, written))
    code = conclude(new_console(), result.diagnosis, strict=strict)
    if viewer is not None:
        wait_for_viewers(outputs)
    return code


def deliver_people(
    result: PeopleResult,
    outputs: Outputs,
    viewer: PeopleRecording | None = None,
    display: Callable[[PeopleResult, PeopleRecording], None] = show_people,
    *,
    strict: bool = False,
) -> int:
    """The same for several people. Returns and raises as deliver."""
    result = _looked_at(result, outputs)
    _deliver(
        lambda: write_people(result, outputs, viewer, display),
        lambda written: print_people(new_console(), result, written),
    )
    code = conclude(new_console(), result.diagnosis, strict=strict)
    if viewer is not None:
        wait_for_viewers(outputs)
    return code


def _looked_at(result: AnyResult, outputs: Outputs) -> AnyResult:
    with new_console(stderr=True).status("looking for what may be wrong"):
        return diagnosed(result, outputs.world_up)


def _deliver(write: Callable[[], tuple[Path, ...]], summary: Callable[[tuple[Path, ...]], None]) -> None:
    try:
        written = write()
    except OutputError as error:
        summary(error.written)
        raise
    summary(written)
