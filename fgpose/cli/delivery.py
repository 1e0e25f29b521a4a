"""The end of a command: a result is written, shown and summed up, and what is probably wrong is said."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fgpose.cli.console import new_console, progress_bar, quiet_progress
from fgpose.cli.tables import print_result
from fgpose.cli.viewers import wait_for_viewers
from fgpose.finding import Code, Severity
from fgpose.pipeline import AnySource, Display, OutputError, Outputs, Result, run_smooth, show, write_outputs
from fgpose.pipeline.diagnosed import diagnosed, looked_at
from fgpose.sampling import frames_per_second
from fgpose.viewer import Recording

if TYPE_CHECKING:
    from rich.console import Console

    from fgpose.config import Config
    from fgpose.diagnosis.diagnose import Diagnosis
    from fgpose.geometry.camera import CameraRig
    from fgpose.people_observations import PeopleObservations

PROBABLY_WRONG = 3
"""Exit code with --strict where a finding says that numbers are wrong."""
_MARKS = {Severity.WRONG: "!!", Severity.DOUBTFUL: "!", Severity.NOTE: "-"}
Summary = Callable[[Result, tuple[Path, ...]], None]
"""Prints a summary of a result and the files that it is in."""


def print_findings(console: Console, diagnosis: Diagnosis) -> None:
    """One paragraph for each finding, the severest first; then what was judged, and what was not."""
    # Repairs were said when the files were read.
    findings = [each for each in diagnosis.findings if each.code is not Code.READ_WITH_REPAIRS]
    for finding in findings:
        console.print(f"{_MARKS[finding.severity]} {finding.text}", soft_wrap=True)
    if diagnosis.judged:
        only_notes = diagnosis.worst in (None, Severity.NOTE)
        nothing = "Nothing else suspicious" if findings else "Nothing suspicious"
        said = nothing if only_notes else "Looked at"
        console.print(f"{said}: {', '.join(diagnosis.judged)}.", soft_wrap=True)
    if diagnosis.not_judged:
        by_reason: dict[str, list[str]] = {}
        for what, why in diagnosis.not_judged.items():
            by_reason.setdefault(why, []).append(what)
        reasons = "; ".join(f"{', '.join(of_it)} ({why})" for why, of_it in by_reason.items())
        console.print(f"Not judged: {reasons}.", soft_wrap=True)


def look_at(console: Console, people: PeopleObservations, rig: CameraRig) -> None:
    """Print what is probably wrong with a recording from which this rig was calibrated or synchronised."""
    from fgpose.association.common_clock import on_common_clock

    with quiet_progress("looking for what may be wrong") as progress:
        diagnosis = looked_at(*on_common_clock(people.subset(rig.names), rig), progress=progress)
    console.print("The recording with this calibration:")
    print_findings(console, diagnosis)


def conclude(console: Console, diagnosis: Diagnosis | None, *, strict: bool) -> int:
    """Print what was found of a result, and a last line that nobody overlooks if it is probably wrong.

    Returns:
        The exit code: 3 in that case if it is strict, else 0.
    """
    if diagnosis is None:
        return 0
    print_findings(console, diagnosis)
    if diagnosis.worst is not Severity.WRONG:
        return 0
    codes = dict.fromkeys(finding.code for finding in diagnosis.findings if finding.severity is Severity.WRONG)
    line = f"THIS RESULT IS PROBABLY WRONG: {', '.join(codes)}. Read the lines with !! above before you use it."
    console.print(f"[bold red]{line}[/]" if console.is_terminal else line, markup=console.is_terminal, soft_wrap=True)
    return PROBABLY_WRONG if strict else 0


def _say_what_is_shown(console: Console, result: Result, outputs: Outputs) -> None:
    """Of a recording of which the viewer does not show every frame."""
    every = outputs.shown_every(result.frame_time_s)
    if not outputs.shown or every == 1:
        return
    what = outputs.rrd if "rrd" in outputs.formats else "the viewer"
    fps, begin_s = frames_per_second(result.frame_time_s) / every, np.floor(result.frame_time_s[0])
    kept = next((path for path in outputs.trajectory_paths(result.saved) if path.suffix == ".parquet"), None)
    whole = (
        "" if kept is None else f"; all of a minute: fgpose view {kept} --from {begin_s:.0f} --to {begin_s + 60:.0f}"
    )
    console.print(f"{what} shows one frame in {every}, {fps:.3g} a second (--rrd-fps){whole}", soft_wrap=True)


@contextmanager
def windows_kept(outputs: Outputs) -> Iterator[None]:
    """An error or an interrupt meanwhile is told, as its note, which windows this run leaves to the next."""
    before = _windows(outputs)
    try:
        yield
    except BaseException as error:
        # Others may be of other parameters, which nobody goes on from; a run that does has said so when it began.
        own = {path.parent for path in _windows(outputs) - before}
        n_kept = sum(path.parent in own for path in _windows(outputs))
        if n_kept:
            windows = "1 window that is" if n_kept == 1 else f"{n_kept} windows that are"
            kept_in = f"{windows} solved {'is' if n_kept == 1 else 'are'} kept in {outputs.unfinished}"
            error.add_note(f"{kept_in}; the same command goes on from there")
        raise


def smoothed(source: AnySource, config: Config, outputs: Outputs) -> Result:
    """run_smooth, compared and kept as the outputs need it, with a progress bar."""
    with progress_bar("smoothing") as progress:
        return run_smooth(
            source,
            config,
            progress,
            compare=outputs.compared_every(source.observations.frame_time_s),
            unfinished=outputs.unfinished,
        )


def _windows(outputs: Outputs) -> set[Path]:
    return set(outputs.unfinished.glob("*/*.npz"))


def deliver(
    result: Result,
    outputs: Outputs,
    viewer: Recording | None = None,
    display: Display = show,
    summary: Summary | None = None,
    *,
    strict: bool = False,
    finish: Callable[[], None] = lambda: None,
) -> int:
    """Diagnose a result, write it, show it, print its summary and what is probably wrong; then finish, and if it is
    live, serve the viewers until Ctrl-C.

    Returns:
        The exit code; see conclude.

    Raises:
        ValueError: nothing is determined.
        OutputError: a file could not be written; the others were, and the result has been summed up.
    """
    summary = summary or (lambda result, written: print_result(new_console(), result, written))
    with quiet_progress("looking for what may be wrong") as progress:
        result = diagnosed(result, outputs.world_up, progress)
    try:
        written = write_outputs(result, outputs, viewer, display)
    except OutputError as error:
        summary(result, error.written)
        raise
    shutil.rmtree(outputs.unfinished, ignore_errors=True)
    summary(result, written)
    _say_what_is_shown(new_console(), result, outputs)
    code = conclude(new_console(), result.diagnosis, strict=strict)
    finish()
    if viewer is not None:
        wait_for_viewers(outputs)
    return code
