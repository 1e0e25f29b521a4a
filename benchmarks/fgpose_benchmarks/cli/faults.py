"""The benchmark of faults. The docstrings are what --help prints."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from fgpose.cli.console import new_console, print_written, progress_bar
from fgpose.cli.process import command_line

# A tenth of it: what fits into the tests.
_QUICK_DAMAGES = (
    "half as large images",
    "two cameras exchanged",
    "centimetres as metres",
    "6 frames lost",
    "nobody for most of the time",
)


@dataclass(frozen=True, kw_only=True)
class Faults:
    """Damaged recordings: what is noticed, named rightly, and mended by the advice.

    Each damage on five simulated clips and two real ones with two, three and four cameras, and more than a hundred
    recordings undamaged. Writes outcomes.json and report.md into the output folder. Takes an hour and a half on two
    cores; outcomes are kept as they come, and an interrupted run goes on with --resume.

    Example: fgpose benchmark faults --quick
    """

    damages: Annotated[tuple[str, ...], arg(metavar="NAME ...", help_behavior_hint="(default: all)")] = ()
    """Only these damages, by the names in the report."""
    clips: Annotated[int, arg(metavar="N")] = 5
    """On so many of the five simulated clips, the first ones."""
    real: bool = True
    """On the real recordings too."""
    quick: bool = False
    """Five damages on one clip of 6 s: for a first look."""
    resume: bool = False
    """Keep the outcomes that stand in the output folder, and find the others."""
    output: Annotated[Path, arg(metavar="FOLDER", aliases=("-o",))] = Path("out/benchmark-faults")
    """Where the report goes."""
    workers: Annotated[int, arg(metavar="N")] = 2
    """Number of processes."""

    def run(self) -> None:
        from fgpose.io.atomic import check_writable
        from fgpose_benchmarks.faults.benchmark import find_damages, run
        from fgpose_benchmarks.faults.outcome import DamageOutcome
        from fgpose_benchmarks.faults.real import real_takes
        from fgpose_benchmarks.faults.report import OUTCOMES, read_outcomes, write_outcomes, write_report
        from fgpose_benchmarks.faults.take import CLIPS, SECONDS, controls, takes

        if not 0 <= self.clips <= len(CLIPS):
            raise ValueError(f"--clips must be from 0 to {len(CLIPS)}, got {self.clips}")
        if self.workers < 1:
            raise ValueError(f"--workers must be at least 1, got {self.workers}")
        damages = find_damages(self.damages or (_QUICK_DAMAGES if self.quick else ()))
        check_writable(self.output)
        every = list(takes(CLIPS[: 1 if self.quick else self.clips], 6.0 if self.quick else SECONDS))
        if not self.quick:
            every += [*controls(CLIPS[: self.clips]), *(real_takes() if self.real else ())]
        n_all = sum(1 + sum(each.can_befall(take) for each in damages) for take in every)
        stored = self.output / OUTCOMES
        found = read_outcomes(stored) if self.resume and stored.exists() else []
        with progress_bar("benchmark", "recordings") as progress:

            def keep(outcome: DamageOutcome) -> None:
                found.append(outcome)
                write_outcomes(found, stored)
                progress(len(found), n_all)

            progress(len(found), n_all)
            outcomes = run(every, damages, tuple(found), keep, self.workers)
        path = write_report(outcomes, self.output, command_line())
        print_written(new_console(), path)
