"""The benchmark of several people, as the runner takes it."""

from __future__ import annotations

from fgpose_benchmarks.comparison.runner import Benchmark
from fgpose_benchmarks.people.recording import PeopleRecording, PeopleResult
from fgpose_benchmarks.people.scores import PeopleScore, score_people
from fgpose_benchmarks.people.variants import TUNING_CLIPS, VARIANTS, VERSION, record

_SHORT_S = 0.5


def _warm_up() -> PeopleRecording:
    return record(VARIANTS[0], TUNING_CLIPS[0], _SHORT_S)


PEOPLE: Benchmark[PeopleRecording, PeopleResult, PeopleScore] = Benchmark(
    "people", VERSION, score_people, PeopleScore, _warm_up, ("people", "comparison/scores.py")
)
