"""The benchmark of calibration from people. The docstrings are what --help prints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import arg

from fgpose.cli.console import counting_bar, new_console, print_written
from fgpose_benchmarks.cli.method_comparison import MethodComparison, OutputFolder

if TYPE_CHECKING:
    from fgpose_benchmarks.calibration.recording import CalibrationMethod
    from fgpose_benchmarks.calibration.scores import CalibrationScore
    from fgpose_benchmarks.calibration.variants import CalibrationVariant

_OUTPUT = Path("out/benchmark-calibrate")
_QUICK_VARIANTS = ("walk_ring_4", "walk_corners_3", "shared_equal_4", "balance_blazepose")
_QUICK_S = 10.0
# What each part is for shows on these; all variants would take a night.
_ABLATION_VARIANTS = ("walk_ring_4", "walk_mixed_5", "walk_one_sided_4", "shared_equal_4", "spot_ring_4", "pair")


@dataclass(frozen=True, kw_only=True)
class Calibrate(MethodComparison):
    """Calibration from people: rigs found from walkers in simulated studios, beside the true ones.

    Two to eight cameras on rings, in corners, on one side; known and unknown focal lengths; videos that start up to a
    minute apart; several people; people who do what does not help; and the real recordings that come with fgpose, their
    calibration thrown away. Writes scores.json and report.md into the output folder. Finished results are kept there in
    the folder cache, so an interrupted run continues where it was. Results that a change of the code affects are
    measured again.

    Example: fgpose benchmark calibrate --quick
    """

    quick: bool = False
    """Four variants, 10 s of one walk: for a first look."""
    ablation: bool = False
    """Instead of the methods: the chain with one part turned off at a time, on six variants."""
    output: OutputFolder = _OUTPUT
    draws: Annotated[int, arg(metavar="N")] = 3
    """How many people, walks and draws of the errors each variant has, up to 5."""

    def run(self) -> None:
        from fgpose_benchmarks.calibration.report import write_report
        from fgpose_benchmarks.comparison.scores import save_scores

        if not 1 <= self.draws <= 5:
            raise ValueError(f"--draws must be 1 to 5, got {self.draws}")
        variants, methods = self._variants(), self._methods()
        self.check_comparison()
        scores = self._scores(variants, methods)
        save_scores(scores, self.output / "scores.json")
        draws = [f"--draws {self.draws}"] if self.draws != 3 else []
        path = write_report(scores, self.output, self.command("fgpose benchmark calibrate", *draws))
        print_written(new_console(), path)

    def _variants(self) -> list[CalibrationVariant]:
        from fgpose_benchmarks.calibration.real import available
        from fgpose_benchmarks.calibration.variants import VARIANTS, find_variant

        # A real recording that is not part of the package is left out unless it is asked for.
        every = tuple(variant.name for variant in VARIANTS if variant.group != "real" or variant.name in available())
        every = _QUICK_VARIANTS if self.quick else _ABLATION_VARIANTS if self.ablation else every
        variants = [find_variant(name) for name in dict.fromkeys(self.variants or every)]
        if not self.quick:
            return variants
        return [replace(variant, duration_s=min(variant.duration_s, _QUICK_S)) for variant in variants]

    def _methods(self) -> list[CalibrationMethod]:
        from fgpose_benchmarks.accuracy.methods import find_methods
        from fgpose_benchmarks.calibration.methods import ABLATIONS, METHODS

        every = list(ABLATIONS if self.ablation else METHODS)
        return find_methods(tuple(dict.fromkeys(self.methods)), every) if self.methods else every

    def _scores(
        self, variants: Sequence[CalibrationVariant], methods: Sequence[CalibrationMethod]
    ) -> list[CalibrationScore]:
        from fgpose_benchmarks.calibration.benchmark import CALIBRATION
        from fgpose_benchmarks.calibration.variants import TEST_CLIPS, TUNING_CLIPS, recordings
        from fgpose_benchmarks.comparison.runner import run

        clips = (TEST_CLIPS if self.clips == "test" else TUNING_CLIPS)[: 1 if self.quick else self.draws]
        n_recordings = sum(1 if variant.group == "real" else len(clips) for variant in variants)
        with counting_bar("benchmark", "results", n_recordings * len(methods)) as advance:
            return run(CALIBRATION, recordings(variants, clips), methods, self.cache_folder, advance, self.workers)
