"""A short soak of the online estimator, in child processes: a crash must be seen as one."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import pytest

import fgpose
import soak
from fgpose_benchmarks.synthetic import ring_rig
from soak_scenes import TROUBLES, draw, parts

FRAMES = 40


@pytest.mark.slow
def test_the_estimator_lives(tmp_path: Path) -> None:
    results = soak.soak(0, 6, FRAMES, tmp_path)
    assert {trouble for result in results for trouble in result.conditions} >= set(TROUBLES)
    assert not {result.seed: reasons for result in results if (reasons := soak.failures(result))}


def two_cameras_that_miss_half(seed: int) -> int:
    """Windows of more frames than a frame has variables, time and again: what used to end in a segmentation fault."""
    hard = replace(
        draw(seed),
        rig=ring_rig().subset(["ring_0", "ring_1"]),
        config=fgpose.Config(),
        fps=60.0,
        missing_share=0.6,
        with_3d=False,
        troubles=frozenset({"missing detections"}),
    )
    estimator = fgpose.Estimator(hard.rig, hard.skeleton, hard.config)
    for frame in next(parts(hard, 120)):
        estimator.update(frame)
    return estimator.repairs


@pytest.mark.slow
def test_two_cameras_that_miss_half_of_the_detections() -> None:
    with ProcessPoolExecutor(max_workers=1, mp_context=get_context("spawn")) as child:
        assert child.submit(two_cameras_that_miss_half, 1).result(timeout=100) == 0


def test_a_crash_ends_one_run_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And what is done is not done again."""
    program = tmp_path / "run.py"
    program.write_text(
        "import json, os, signal, sys\n"
        "path, first, runs, frames = sys.argv[1], *map(int, sys.argv[2:])\n"
        "for seed in range(first, first + runs):\n"
        "    if seed == 2:\n"
        "        os.kill(os.getpid(), signal.SIGSEGV)\n"
        "    with open(path, 'a') as file:\n"
        "        print(json.dumps({'seed': seed, 'n_frames': frames, 'conditions': ['any']}), file=file)\n"
    )
    monkeypatch.setattr(soak, "_RUN", program)
    results = soak.soak(0, 4, 10, tmp_path)
    assert [result.death for result in results] == [None, None, "exit code -11", None]
    rows = soak.table(results).splitlines()
    assert "| all | 4 | 1 | 0 | 0 | 0 | 0.0 |" in rows
    assert "| any | 3 | 0 | 0 | 0 | 0 | 0.0 |" in rows
    assert {f"| {condition} | 1 | 1 | 0 | 0 | 0 | 0.0 |" for condition in draw(2).conditions} <= set(rows)
    program.write_text("raise SystemExit('run again')")
    assert soak.soak(1, 3, 10, tmp_path) == results[1:]
