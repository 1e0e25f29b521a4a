"""The benchmark of random recordings. The docstrings are what --help prints."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import arg

from fgpose.cli.console import counting_bar, new_console, print_written
from fgpose.cli.process import command_line
from fgpose_benchmarks.cli.method_comparison import OutputFolder

_SCORES = "scores.json"


@dataclass(frozen=True, kw_only=True)
class Random:
    """Recordings whose rig, motion and errors are drawn at random, beside a linear method and an oracle.

    2 to 8 cameras, calibrated exactly or not, 15 to 100 Hz, detections with heavy tails, biases, swapped sides, joints
    that are hidden and then missing, adrift, frozen or in the background, useless confidences, per-view 3D of several
    kinds. With --people one to eight of them, who pass each other, leave and come back, are missed, seen twice or
    where nobody is. A recording takes about a minute on one core. Writes scores.json and report.md into the output
    folder. Finished results are kept there in the folder cache, so an interrupted run continues where it was.

    Example: fgpose benchmark random --recordings 10
    """

    recordings: Annotated[int, arg(metavar="N")] = 40
    """How many."""
    first: Annotated[int, arg(metavar="SEED")] = 100
    """Seed of the first; the others follow. Those below 100 were looked at when fgpose was changed. One that nobody
    could tell anything from is left out."""
    people: bool = False
    """Who is who, and where: recordings of several people."""
    methods: Annotated[tuple[str, ...], arg(metavar="NAME ...", help_behavior_hint="(default: six, or all)")] = ()
    """Only these methods, by their names in the open benchmark, or in that of several people."""
    output: OutputFolder = Path("out/benchmark-random")
    workers: Annotated[int, arg(metavar="N")] = 2
    """Number of processes."""
    cache: bool = True
    """Keep finished results, and use those that were kept."""

    def run(self) -> None:
        from fgpose.io.atomic import check_writable
        from fgpose_benchmarks.accuracy.methods import find_methods
        from fgpose_benchmarks.comparison.runner import run
        from fgpose_benchmarks.comparison.scores import save_scores
        from fgpose_benchmarks.random_recordings.benchmark import ONE_PERSON, SEVERAL_PEOPLE

        for option, value, least in (
            ("recordings", self.recordings, 1),
            ("first", self.first, 0),
            ("workers", self.workers, 0),
        ):
            if value < least:
                raise ValueError(f"--{option} must be at least {least}, got {value}")
        kind = SEVERAL_PEOPLE if self.people else ONE_PERSON
        chosen = find_methods(tuple(dict.fromkeys(self.methods or kind.names)), kind.methods)
        check_writable(self.output)
        seeds = range(self.first, self.first + self.recordings)
        with counting_bar("benchmark", "results", len(seeds) * len(chosen)) as advance:
            cache = self.output / "cache" if self.cache else None
            scores: list[Any] = run(kind.benchmark, kind.recordings(seeds), chosen, cache, advance, self.workers)
        if not scores:
            raise ValueError("nobody could tell anything from these recordings: choose others (--first, --recordings)")
        save_scores(scores, self.output / _SCORES)
        print_written(new_console(), kind.write_report(scores, self.output, command_line()))
