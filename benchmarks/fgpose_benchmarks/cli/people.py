"""The benchmark of several people. The docstrings are what --help prints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fgpose.cli.console import counting_bar, new_console, print_written
from fgpose_benchmarks.cli.method_comparison import MethodComparison, OutputFolder

if TYPE_CHECKING:
    from fgpose_benchmarks.people.recording import PeopleMethod
    from fgpose_benchmarks.people.scores import PeopleScore
    from fgpose_benchmarks.people.variants import PeopleVariant

_OUTPUT = Path("out/benchmark-people")
_QUICK_VARIANTS = ("4_people_5_cameras", "4_people_3_cameras_low", "4_people_5_cameras_unsynchronised")
# As much as fits into 90 seconds on two cores.
_QUICK_CLIPS = 1
_QUICK_S = 5.0


@dataclass(frozen=True, kw_only=True)
class People(MethodComparison):
    """Several people: who is who, and their poses, in simulated crowds.

    Two to eight people walk, work, sit down, pass each other, leave and come back, hidden by each other and by
    furniture, seen by three to eight cameras, high and low, synchronous or not. fgpose in batch and online, the batch
    that is told who is who, and what others published. Takes about half an hour on two cores. Writes scores.json and
    report.md into the output folder. Finished results are kept there in the folder cache, so an interrupted run
    continues where it was. Results that a change of the code affects are measured again.

    Example: fgpose benchmark people --quick
    """

    quick: bool = False
    """Three variants, the first 5 s of one clip: for a first look."""
    ablation: bool = False
    """Instead of the methods: fgpose's batch with one part of the association removed or replaced at a time."""
    output: OutputFolder = _OUTPUT

    def run(self) -> None:
        from fgpose_benchmarks.comparison.scores import save_scores
        from fgpose_benchmarks.people.report import write_report

        variants, methods = self._variants(), self._methods()
        self.check_comparison()
        scores = self._scores(variants, methods)
        save_scores(scores, self.output / "scores.json")
        path = write_report(scores, self.output, self.command("fgpose benchmark people"))
        print_written(new_console(), path)

    def _variants(self) -> list[PeopleVariant]:
        from fgpose_benchmarks.people.variants import VARIANTS, find_variant

        every = _QUICK_VARIANTS if self.quick else tuple(variant.name for variant in VARIANTS)
        return [find_variant(name) for name in dict.fromkeys(self.variants or every)]

    def _methods(self) -> list[PeopleMethod]:
        from fgpose_benchmarks.accuracy.methods import find_methods
        from fgpose_benchmarks.people.ablation import ablations
        from fgpose_benchmarks.people.methods import METHODS

        every = ablations() if self.ablation else list(METHODS)
        return find_methods(tuple(dict.fromkeys(self.methods)), every) if self.methods else every

    def _scores(self, variants: Sequence[PeopleVariant], methods: Sequence[PeopleMethod]) -> list[PeopleScore]:
        from fgpose_benchmarks.comparison.runner import run
        from fgpose_benchmarks.people.benchmark import PEOPLE
        from fgpose_benchmarks.people.variants import DURATION_S, TEST_CLIPS, TUNING_CLIPS, recordings

        clips = TEST_CLIPS if self.clips == "test" else TUNING_CLIPS
        clips, duration_s = (clips[:_QUICK_CLIPS], _QUICK_S) if self.quick else (clips, DURATION_S)
        with counting_bar("benchmark", "results", len(variants) * len(clips) * len(methods)) as advance:
            every = recordings(variants, clips, duration_s)
            return run(PEOPLE, every, methods, self.cache_folder, advance, self.workers)
