"""The benchmark of random recordings, as the runner takes it."""

from __future__ import annotations

from fgpose_benchmarks.accuracy.open_benchmark import OPEN
from fgpose_benchmarks.comparison.recording import BenchmarkRecording, MethodResult
from fgpose_benchmarks.comparison.runner import Benchmark
from fgpose_benchmarks.comparison.scores import Score, score
from fgpose_benchmarks.random_recordings.recording import VERSION

METHODS = ("MSAC by confidence, 6 Hz", "fgpose online, lag 0", "fgpose online, lag 0.2 s", "fgpose batch", "oracle")
"""Those of the open benchmark that run: what needs no estimator, fgpose, and what could be had."""

RANDOM: Benchmark[BenchmarkRecording, MethodResult, Score] = Benchmark(
    "random", VERSION, score, Score, OPEN.warm_up, OPEN.sources
)
