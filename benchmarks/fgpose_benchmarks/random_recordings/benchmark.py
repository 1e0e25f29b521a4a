"""The benchmarks of random recordings, of one person and of several, as the runner takes them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fgpose_benchmarks.accuracy.methods import methods
from fgpose_benchmarks.accuracy.open_benchmark import OPEN
from fgpose_benchmarks.comparison.recording import Method
from fgpose_benchmarks.comparison.runner import Benchmark
from fgpose_benchmarks.comparison.scores import Score, score
from fgpose_benchmarks.people.benchmark import PEOPLE
from fgpose_benchmarks.people.methods import METHODS
from fgpose_benchmarks.people.report import write_report as write_report_of_people
from fgpose_benchmarks.people.scores import PeopleScore, score_people
from fgpose_benchmarks.random_recordings.crowds import crowds
from fgpose_benchmarks.random_recordings.recording import VERSION, recordings
from fgpose_benchmarks.random_recordings.report import write_report


@dataclass(frozen=True)
class RandomBenchmark:
    """Recordings of one kind, and who is compared on them."""

    benchmark: Benchmark[Any, Any, Any]
    recordings: Callable[[Iterable[int]], Iterator[Any]]
    """By their seeds."""
    methods: Sequence[Method[Any, Any]]
    names: tuple[str, ...]
    """Of those that run unless others are asked for."""
    write_report: Callable[[Sequence[Any], Path, str], Path]


ONE_PERSON = RandomBenchmark(
    Benchmark("random", VERSION, score, Score, OPEN.warm_up, OPEN.sources),
    recordings,
    methods(),
    # What needs no estimator, fgpose, and what could be had.
    (
        "MSAC by confidence, 6 Hz",
        "fgpose online, lag 0",
        "fgpose online, lag 0.2 s",
        "fgpose online by window, lag 0.2 s",
        "fgpose batch",
        "oracle",
    ),
    write_report,
)
SEVERAL_PEOPLE = RandomBenchmark(
    Benchmark("random people", VERSION, score_people, PeopleScore, PEOPLE.warm_up, PEOPLE.sources),
    crowds,
    METHODS,
    tuple(method.name for method in METHODS),
    write_report_of_people,
)
