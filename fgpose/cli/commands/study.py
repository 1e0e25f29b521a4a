"""Studies of many recordings."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import FlagCreatePairsOff, Positional, arg

from fgpose.cli.console import ProgressLines, new_console, new_table, print_written

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Task

    from fgpose.study import Plan, RecordingOutcome, StudyResult, Trial
    from fgpose.study.run import OnBegin, OnOutcome
    from fgpose.study.study import StudyDescription

FAILED = 1
"""Exit code where a recording has failed."""
_MOST_FAILURES = 30


@dataclass(frozen=True, kw_only=True)
class Study:
    """Estimate all recordings of a study, into one data set.

    Works on all cores or on a cluster. Writes into the study's output folder: recordings/SUBJECT/SESSION/TRIAL/ with
    the results of each; motion/ and angles/, data sets that pandas, polars and DuckDB open as one table; quality.csv
    and quality.parquet with a row for each recording. What is finished and has not changed is not done again: after
    Ctrl-C, a crash or a change of the study file, run the same command. A recording that fails is in the table with its
    reason, which is also written beside its folder, and stops nothing; the exit code is 1 then.

    Example: fgpose study study.toml --init, then edit study.toml, then fgpose study study.toml --dry-run
    """

    file: Annotated[Positional[Path], arg(metavar="FILE")]
    """The study file (TOML). --init writes one with comments."""
    init: Annotated[bool, FlagCreatePairsOff] = False
    """Write a template of the study file, and do nothing else."""
    dry_run: Annotated[bool, FlagCreatePairsOff] = False
    """List the recordings and the steps that would be done for each, and do nothing else."""
    only: Annotated[str, arg(metavar="PATTERN", help_behavior_hint="(default: all)")] = ""
    """Only the recordings that match, by subject/session/trial, as "S01/*/*"."""
    workers: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: one for each core)")] = None
    """Processes on this machine."""
    scheduler: Annotated[str, arg(metavar="ADDRESS", help_behavior_hint="(default: this machine)")] = ""
    """A Dask scheduler whose workers do the work, as tcp://host:8786. They need fgpose and the same paths."""

    def run(self) -> int:
        if self.init:
            return self._write_template()
        if self.workers is not None and self.workers < 1:
            raise ValueError(f"--workers must be at least 1, got {self.workers}")
        from fgpose.study import Plan, load_study

        if not self.file.exists():
            raise ValueError(f"{self.file}: there is no such file; fgpose study {self.file} --init writes one")
        study = load_study(self.file)
        if self.dry_run:
            return print_plan(new_console(), Plan(study, self.only))
        return FAILED if run_and_print(study, self).counts["failed"] else 0

    def _write_template(self) -> int:
        from fgpose.io.atomic import write_text

        if self.file.exists():
            raise ValueError(f"{self.file}: there is such a file already; it is not replaced")
        write_text(self.file, resources.files("fgpose.study").joinpath("template.toml").read_text(encoding="utf-8"))
        new_console().print(f"wrote {self.file}: edit it, then fgpose study {self.file} --dry-run", soft_wrap=True)
        return 0


def run_and_print(study: StudyDescription, options: Study) -> StudyResult:
    """Run a study with a progress bar, and say what came of it."""
    from fgpose.study import run_study

    with _progress() as (on_begin, on_outcome):
        result = run_study(
            study,
            scheduler=options.scheduler,
            n_workers=options.workers,
            only=options.only,
            on_begin=on_begin,
            on_outcome=on_outcome,
        )
    _print_result(new_console(), result)
    return result


def print_plan(console: Console, plan: Plan) -> int:
    """A table of what would be done. Returns the exit code: 1 if a recording cannot be done."""

    plan.counted()
    table = new_table("recording", "from", "steps")
    n_due = n_problems = n_all = 0
    for recording in plan:
        steps, problem = _steps(plan.study, recording)
        n_all, n_due, n_problems = n_all + 1, n_due + bool(steps and not problem), n_problems + bool(problem)
        source = recording.source
        shown = source.relative_to(plan.study.root) if source.is_relative_to(plan.study.root) else source
        table.add_row(recording.key if recording.trial else "-", str(shown), problem or steps or "unchanged")
    console.print(table)
    console.print(
        f"{n_all} recordings: {n_due} to be done, {n_problems} cannot be, {n_all - n_due - n_problems} unchanged."
    )
    return FAILED if n_problems else 0


def _steps(study: StudyDescription, recording: Trial) -> tuple[str, str]:
    """What would be done, and what is wrong."""
    from fgpose.study.process import due

    if recording.problem:
        return "", recording.problem
    try:
        return ", ".join(due(study, recording)), ""
    except OSError as error:
        return "", f"{error.filename}: {error.strerror}"


@contextmanager
def _progress() -> Iterator[tuple[OnBegin, OnOutcome]]:
    """A bar with the rate and the time left, once it is known how many there are, and a line for each recording that
    fails."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, TextColumn, TimeRemainingColumn
    from rich.text import Text

    class Rate(ProgressColumn):
        def render(self, task: Task) -> Text:
            return Text(f"{60 * task.speed:.1f}/min" if task.speed else "-/min")

    columns = (
        TextColumn("recordings"),
        BarColumn(),
        MofNCompleteColumn(),
        Rate(),
        TimeRemainingColumn(elapsed_when_finished=True),
    )
    console = new_console(stderr=True)
    # The time of one recording says little where workers take turns: the rate is that of the last half hour.
    bar = Progress(*columns, console=console, speed_estimate_period=1800)
    number = bar.add_task("recordings", total=None)
    lines = ProgressLines(console, "study", "recordings")
    task, shown = bar.tasks[0], bar if console.moves else lines

    def on_begin(n_recordings: int) -> None:
        bar.update(number, total=n_recordings)
        lines.told(0, n_recordings)
        shown.start()

    def on_outcome(outcome: RecordingOutcome) -> None:
        if outcome.status == "failed":
            console.print(f"failed: {outcome.recording.key}: {outcome.reason}", soft_wrap=True)
        bar.update(number, advance=1)
        lines.told(int(task.completed), int(task.total or 0))

    try:
        yield on_begin, on_outcome
    finally:
        if task.total is not None:
            shown.stop()


def _print_result(console: Console, result: StudyResult) -> None:
    counts = result.counts
    console.print(f"{counts['done']} done, {counts['unchanged']} unchanged, {counts['failed']} failed")
    for recording, reason in result.failures[:_MOST_FAILURES]:
        console.print(f"  failed: {recording}: {reason}", soft_wrap=True)
    if len(result.failures) > _MOST_FAILURES:
        console.print(f"  and {len(result.failures) - _MOST_FAILURES} more, see quality.csv")
    for note in result.notes:
        console.print(f"note: {note}", soft_wrap=True)
    print_written(console, *result.written)
