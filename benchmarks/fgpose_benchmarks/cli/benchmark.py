"""The benchmarks. The docstrings are what --help prints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg, subcommand

from fgpose.cli.console import counting_bar, new_console, print_written
from fgpose_benchmarks.cli.calibrate import Calibrate
from fgpose_benchmarks.cli.data import Human36M, OccludeImages, Workcell
from fgpose_benchmarks.cli.faults import Faults
from fgpose_benchmarks.cli.method_comparison import MethodComparison, OutputFolder
from fgpose_benchmarks.cli.people import People
from fgpose_benchmarks.cli.random_recordings import Random

if TYPE_CHECKING:
    from fgpose_benchmarks.accuracy.variants import Variant
    from fgpose_benchmarks.comparison.recording import Method
    from fgpose_benchmarks.comparison.scores import Score

_OUTPUT = Path("out/benchmark")
_SCORES = "scores.json"
_QUICK_VARIANTS = ("clean", "occluded", "occluded_2_cameras", "desync_3", "industrial", "snapping")
# As much as fits into 90 seconds on two cores.
_QUICK_CLIPS = 2
_QUICK_FRAMES = 100
ACTIONS = ("open", "random", "people", "calibrate", "faults", "report", "human36m", "occlude", "workcell")
# The first takes as long as all others together; of the lags, none and the one of the tables are enough.
_NOT_QUICK = ("fgpose batch, self-calibrated", "fgpose online by window, lag 0.2 s", "fgpose online, lag 0.5 s")
# Larger, smaller losses of accuracy pass --check; smaller, harmless changes of the code fail it.
_MARGIN = 0.05


@dataclass(frozen=True, kw_only=True)
class Open(MethodComparison):
    """The open benchmark: real motion, simulated detections with the errors of real ones, in families of variants.

    Every method on the standard family; on the other families, for which no default may be chosen, only fgpose, the
    best method per frame and the oracle. Takes less than 25 minutes on two cores. Writes scores.json and the report
    into the output folder. Finished results are kept there in the folder cache, so an interrupted run continues where
    it was. Results that a change of the code affects are measured again.

    Example: fgpose benchmark open --quick
    """

    quick: bool = False
    """Six variants on the first 100 frames of two clips, without the slowest method and two of the online ones, in less
    than 90 seconds: for a first look."""
    ablation: bool = False
    """Instead of the methods: fgpose's batch with one part removed or replaced at a time."""
    output: OutputFolder = _OUTPUT
    aniposelib: Annotated[
        Path | None, arg(metavar="PYTHON", help_behavior_hint="(default: .venv/bench/bin/python)")
    ] = None
    """Python of an environment that has aniposelib; without one its lines are left out."""
    eks: Annotated[Path | None, arg(metavar="PYTHON", help_behavior_hint="(default: .venv/eks/bin/python)")] = None
    """The same for the Ensemble Kalman Smoother, which takes some minutes for each recording."""
    check: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="(default: none)")] = None
    """Compare the errors with those that --store has written, and fail if they differ. Without aniposelib."""
    store: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="(default: none)")] = None
    """Write the errors of this run, plus and minus 5 %, for --check. Without aniposelib."""

    def run(self) -> None:
        from fgpose_benchmarks.comparison.scores import save_scores

        if self.workers < 1:
            raise ValueError(f"--workers must be at least 1, got {self.workers}")
        variants, methods = self._variants(), self._methods()
        self.check_comparison()
        if self.check is not None:
            self.check.stat()  # report that it is missing before the work is done
        scores = self._scores(variants, methods)
        save_scores(scores, self.output / _SCORES)
        if not self.methods and not self._without_peer and not any(method.group == "peer" for method in methods):
            new_console().print("aniposelib was left out: --aniposelib PYTHON names an environment that has it")
        _report(self.output, self.command("fgpose benchmark"))
        self._compare(scores)

    @property
    def _without_peer(self) -> bool:
        """Stored errors must not depend on whether aniposelib is installed; an ablation is of fgpose alone."""
        return self.ablation or self.check is not None or self.store is not None

    def _compare(self, scores: list[Score]) -> None:
        from fgpose_benchmarks.accuracy.report import check_against, store_intervals

        if self.store is not None:
            store_intervals(scores, self.store, _MARGIN)
            print_written(new_console(), self.store)
        if self.check is None:
            return
        violations = check_against(self.check, scores)
        for violation in violations:
            new_console().print(f"! {violation}", soft_wrap=True)
        if violations:
            raise ValueError(f"{len(violations)} errors are not those stored in {self.check}")
        new_console().print(f"the errors are those stored in {self.check}", soft_wrap=True)

    def _variants(self) -> list[Variant]:
        from fgpose_benchmarks.accuracy.variants import VARIANTS, find_variant

        every = [variant.name for variant in VARIANTS if not self.ablation or variant.family == "standard"]
        names = self.variants or (_QUICK_VARIANTS if self.quick else every)
        return [find_variant(name) for name in dict.fromkeys(names)]

    def _methods(self) -> list[Method]:
        from fgpose_benchmarks.accuracy.ablation import ablations
        from fgpose_benchmarks.accuracy.methods import find_methods, methods
        from fgpose_benchmarks.accuracy.peer import EKS, find_peer

        peers = () if self._without_peer else (find_peer(self.aniposelib), find_peer(self.eks, EKS))
        every = ablations() if self.ablation else methods(*peers)
        if self.methods:
            return find_methods(tuple(dict.fromkeys(self.methods)), every)
        return [method for method in every if not (self.quick and method.name in _NOT_QUICK)]

    def _scores(self, variants: Sequence[Variant], methods: Sequence[Method]) -> list[Score]:
        from fgpose_benchmarks.accuracy.open_benchmark import OPEN
        from fgpose_benchmarks.accuracy.variants import MAX_FRAMES, TEST_CLIPS, TUNING_CLIPS, recordings
        from fgpose_benchmarks.comparison.runner import run

        clips = TEST_CLIPS if self.clips == "test" else TUNING_CLIPS
        clips, max_frames = (clips[:_QUICK_CLIPS], _QUICK_FRAMES) if self.quick else (clips, MAX_FRAMES)
        chosen = {variant: self._methods_on(variant, methods) for variant in variants}
        with counting_bar("benchmark", "results", len(clips) * sum(map(len, chosen.values()))) as advance:
            scores = []
            # Neighbours with the same methods run together: workers are started and warmed up for each run.
            for _, group in groupby(variants, lambda variant: [method.name for method in chosen[variant]]):
                together = list(group)
                every = recordings(together, clips, max_frames)
                scores += run(OPEN, every, chosen[together[0]], self.cache_folder, advance, self.workers)
            return scores

    def _methods_on(self, variant: Variant, methods: Sequence[Method]) -> list[Method]:
        from fgpose_benchmarks.accuracy.methods import methods_for

        return list(methods) if self.methods or self.ablation else methods_for(variant, methods)


@dataclass(frozen=True, kw_only=True)
class Report:
    """Write the report of a benchmark again from its scores.json, without measuring.

    Example: fgpose benchmark report out/benchmark
    """

    folder: Annotated[Positional[Path], arg(metavar="FOLDER")] = _OUTPUT
    """Where scores.json is and the report goes."""

    def run(self) -> None:
        _report(self.folder, "fgpose benchmark")


def _report(folder: Path, command: str) -> None:
    from fgpose_benchmarks.accuracy.report import write_report
    from fgpose_benchmarks.comparison.scores import Score, load_scores

    print_written(new_console(), *write_report(load_scores(folder / _SCORES, Score), folder, command))


@dataclass(frozen=True, kw_only=True)
class Benchmark:
    """Compare fgpose with other methods, where truth is known.

    Without a name it runs the open benchmark: fgpose benchmark --quick is fgpose benchmark open --quick.

    Example: fgpose benchmark --quick
    """

    action: Annotated[
        Annotated[Open, subcommand("open", prefix_name=False)]
        | Annotated[Random, subcommand("random", prefix_name=False)]
        | Annotated[People, subcommand("people", prefix_name=False)]
        | Annotated[Calibrate, subcommand("calibrate", prefix_name=False)]
        | Annotated[Faults, subcommand("faults", prefix_name=False)]
        | Annotated[Report, subcommand("report", prefix_name=False)]
        | Annotated[Human36M, subcommand("human36m", prefix_name=False)]
        | Annotated[OccludeImages, subcommand("occlude", prefix_name=False)]
        | Annotated[Workcell, subcommand("workcell", prefix_name=False)],
        arg(name=""),
    ] = field(default_factory=Open)

    @classmethod
    def completed(cls, arguments: list[str]) -> list[str]:
        """The arguments, with "open" added where no benchmark is named."""
        return arguments if arguments[:1] in ([name] for name in (*ACTIONS, "-h", "--help")) else ["open", *arguments]

    def run(self) -> None:
        self.action.run()
