from __future__ import annotations

import os
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from fgpose_benchmarks.accuracy.methods import find_methods, methods
from fgpose_benchmarks.accuracy.open_benchmark import OPEN
from fgpose_benchmarks.accuracy.variants import TUNING_CLIPS, find_variant, record, recordings
from fgpose_benchmarks.comparison import runner
from fgpose_benchmarks.comparison.recording import BenchmarkRecording, Method, MethodResult
from fgpose_benchmarks.comparison.scores import Score

N_FRAMES = 6
run = partial(runner.run, OPEN)


@pytest.fixture(autouse=True)
def _nothing_is_warm(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runner, "_warm", set())


@pytest.fixture
def three() -> list[BenchmarkRecording]:
    return list(recordings([find_variant("clean")], TUNING_CLIPS[:3], N_FRAMES))


@dataclass
class Counting:
    """A method that is off by a known error, and counts how often it solved each clip."""

    error_m: float
    n_solved: Counter[str] = field(default_factory=Counter)

    def __call__(self, recording: BenchmarkRecording) -> MethodResult:
        if len(recording.truth_m) == N_FRAMES:  # not the warm-up
            self.n_solved[recording.clip] += 1
        return MethodResult(recording.truth_m + np.array([self.error_m, 0.0, 0.0]), None, 0.1)


def counting(*errors_m: float) -> tuple[list[Method], list[Counting]]:
    solvers = [Counting(error_m) for error_m in errors_m]
    return [Method(f"off by {solver.error_m}", "ours", solver) for solver in solvers], solvers


def end_worker(recording: BenchmarkRecording) -> MethodResult:
    os._exit(1)


def numbers(scores: list[Score]) -> list[tuple[str, str, float]]:
    return [(score.clip, score.method, round(score.mpjpe_mm, 6)) for score in scores]


def test_every_method_on_every_recording_in_order(three):
    pair, _ = counting(0.01, 0.02)
    told: list[Score] = []
    scores = run(three, pair, None, told.append, n_workers=0)
    assert numbers(scores) == [
        (clip, method, error)
        for clip in TUNING_CLIPS[:3]
        for method, error in (("off by 0.01", 10), ("off by 0.02", 20))
    ]
    assert sorted(numbers(told)) == sorted(numbers(scores))


def test_an_interrupted_run_continues(three, tmp_path):
    pair, solvers = counting(0.01, 0.02)

    def interrupt_after_three(score: Score) -> None:
        told.append(score)
        if len(told) == 3:
            raise KeyboardInterrupt

    told: list[Score] = []
    with pytest.raises(KeyboardInterrupt):
        run(three, pair, tmp_path, interrupt_after_three, n_workers=0)
    before = sum((solver.n_solved for solver in solvers), Counter())
    assert 3 <= before.total() <= 4
    scores = run(three, pair, tmp_path, n_workers=0)
    assert len(scores) == 6
    # What was told is not solved again, and everything is solved once in the end.
    assert all(set(solver.n_solved.values()) == {1} for solver in solvers)
    assert numbers(run(three, pair, None, n_workers=0)) == numbers(scores)


def test_a_second_run_solves_nothing(three, tmp_path):
    pair, solvers = counting(0.01, 0.02)
    first = run(three, pair, tmp_path, n_workers=0)
    told: list[Score] = []
    assert numbers(run(three, pair, tmp_path, told.append, n_workers=0)) == numbers(first) == numbers(told)
    assert all(solver.n_solved.total() == 3 for solver in solvers)


@pytest.mark.slow
def test_the_cache_knows_a_recording_that_another_process_made():
    # hash() of a string, which tempts for seeds, differs from process to process.
    command = (
        "from fgpose_benchmarks.comparison.runner import _digest;"
        "from fgpose_benchmarks.accuracy.variants import find_variant, record;"
        f"print(_digest(record(find_variant('industrial'), {TUNING_CLIPS[0]!r}, 20)))"
    )
    environment = os.environ | {"PYTHONHASHSEED": "7"}
    other = subprocess.run([sys.executable, "-c", command], capture_output=True, text=True, check=True, env=environment)
    assert other.stdout.strip() == runner._digest(record(find_variant("industrial"), TUNING_CLIPS[0], 20))


def test_no_cache_solves_again_and_writes_nothing(three, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (method,), (solver,) = counting(0.01)
    for _ in range(2):
        run(three, [method], None, n_workers=0)
    assert solver.n_solved.total() == 6
    assert not list(tmp_path.iterdir())


def test_what_has_changed_is_measured_anew(three, tmp_path):
    (method,), (solver,) = counting(0.01)
    run(three, [method], tmp_path, n_workers=0)
    moved = replace(three[0], truth_m=three[0].truth_m + 1e-9)
    run([moved, three[1]], [method], tmp_path, n_workers=0)
    assert solver.n_solved == {three[0].clip: 2, three[1].clip: 1, three[2].clip: 1}
    runner.run(replace(OPEN, version=0), three[1:2], [method], tmp_path, n_workers=0)
    assert solver.n_solved[three[1].clip] == 2


@pytest.mark.parametrize(
    ("changed", "measured"),
    [("smoother.py", 6), ("estimation/solvers/gtsam_batch.py", 6), ("viewer/scene.py", 3), ("data/clip.npz", 3)],
)
def test_a_change_of_the_solver_concerns_all_but_the_peer(three, tmp_path, monkeypatch, changed, measured):
    ours, peer = Counting(0.01), Counting(0.02)
    both = [Method("ours", "ours", ours), Method("peer", "peer", peer)]
    source = tmp_path / "source"
    (source / changed).parent.mkdir(parents=True)
    monkeypatch.setattr(runner, "_SOLVER_SOURCES", (source,))
    try:
        for _ in range(2):
            runner._source_digest.cache_clear()
            run(three, both, tmp_path, n_workers=0)
            (source / changed).write_text("changed = True\n", encoding="utf-8")
    finally:
        runner._source_digest.cache_clear()
    assert (ours.n_solved.total(), peer.n_solved.total()) == (measured, 3)


def test_the_first_solve_of_a_method_is_not_timed(three):
    frames: list[int] = []

    def solve(recording: BenchmarkRecording) -> MethodResult:
        frames.append(len(recording.truth_m))
        return MethodResult(recording.truth_m, None, 0.1)

    run(three, [Method("slow to start", "ours", solve)], None, n_workers=0)
    assert frames == [15, N_FRAMES, N_FRAMES, N_FRAMES]
    frames.clear()
    # Predictions from a file know their own recordings only.
    run(three, [Method("from a file", "file", solve)], None, n_workers=0)
    assert frames == [N_FRAMES] * 3


def test_a_refusal_names_method_and_recording(three):
    def refuse(recording: BenchmarkRecording) -> MethodResult:
        raise ValueError("no thanks")

    with pytest.raises(ValueError, match=r"^picky, cmu_01_04_a \(clean\): no thanks$"):
        run(three, [Method("picky", "file", refuse)], None, n_workers=0)


def test_two_methods_of_one_name_are_refused(three):
    pair, _ = counting(0.01, 0.01)
    with pytest.raises(ValueError, match="two methods have one name"):
        run(three, pair, None, n_workers=0)


def test_recordings_are_taken_one_by_one():
    made: list[str] = []
    told: list[Score] = []

    def lazily() -> Iterator[BenchmarkRecording]:
        for clip in TUNING_CLIPS[:3]:
            # All that was made before has been solved by now.
            assert len(told) >= len(made) - 1
            made.append(clip)
            yield record(find_variant("clean"), clip, N_FRAMES)

    (method,), _ = counting(0.01)
    assert len(run(lazily(), [method], None, told.append, n_workers=0)) == 3


@pytest.mark.slow
def test_two_processes_give_what_one_gives(tmp_path):
    # End to end: real recordings, real methods, real processes, a cache that both ways share.
    names = ["RANSAC, 6 Hz", "fgpose batch"]
    chosen = find_methods(names, methods())
    every = list(recordings([find_variant("industrial")], TUNING_CLIPS[1:3], 40))
    parallel = run(every, chosen, tmp_path, n_workers=2)
    assert [(score.clip, score.method) for score in parallel] == [(r.clip, name) for r in every for name in names]
    assert len(list(tmp_path.iterdir())) == len(parallel)
    here = run(every, chosen, None, n_workers=0)
    # The same code on the same machine, one BLAS thread on both sides.
    assert numbers(here) == numbers(parallel)
    assert numbers(run(every, chosen, tmp_path, n_workers=0)) == numbers(parallel)


@pytest.mark.slow
def test_a_worker_that_is_killed_is_an_error(three):
    with pytest.raises(OSError, match="a worker was killed"):
        run(three[:1], [Method("too large", "file", end_worker)], None, n_workers=1)


def test_a_cache_that_cannot_be_written_is_an_error(three, tmp_path: Path):
    (tmp_path / "cache").touch()
    (method,), _ = counting(0.01)
    with pytest.raises(OSError, match="cache"):
        run(three, [method], tmp_path / "cache", n_workers=0)
