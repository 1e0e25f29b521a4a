"""The open benchmark of one person, as the runner takes it."""

from __future__ import annotations

from fgpose_benchmarks.accuracy.variants import VERSION, find_variant, record
from fgpose_benchmarks.comparison.recording import BenchmarkRecording, MethodResult
from fgpose_benchmarks.comparison.runner import Benchmark
from fgpose_benchmarks.comparison.scores import Score, score

_SHORTEST_CLIP, _N_FRAMES = "cmu_02_03_short", 15


def _warm_up() -> BenchmarkRecording:
    return record(find_variant("clean"), _SHORTEST_CLIP, _N_FRAMES)


OPEN: Benchmark[BenchmarkRecording, MethodResult, Score] = Benchmark(
    "open", VERSION, score, Score, _warm_up, ("accuracy/methods.py", "accuracy/linear.py", "comparison/scores.py")
)
