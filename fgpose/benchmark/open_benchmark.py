"""The open benchmark of one person, as the runner takes it."""

from __future__ import annotations

from fgpose.benchmark.recording import Recording, Result
from fgpose.benchmark.runner import Benchmark
from fgpose.benchmark.scores import Score, score
from fgpose.benchmark.variants import VERSION, find_variant, record

_SHORTEST_CLIP, _N_FRAMES = "cmu_02_03_short", 15


def _warm_up() -> Recording:
    return record(find_variant("clean"), _SHORTEST_CLIP, _N_FRAMES)


OPEN: Benchmark[Recording, Result, Score] = Benchmark(
    "open", VERSION, score, Score, _warm_up, ("methods.py", "linear.py", "scores.py")
)
