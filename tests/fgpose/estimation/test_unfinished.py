"""A run of the smoother that was killed goes on where it was, with the same result to the last bit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import fgpose
from fgpose.config import config_from_dict
from fgpose_benchmarks.synthetic import Scene

# 40 frames at 30 Hz in three windows.
SOLVER = {"window_s": 0.4, "overlap_s": 0.1, "max_iterations": 10}
CONFIG = config_from_dict({"solver": SOLVER})
ARRAYS = ("time_s", "positions_m", "status", "covariance_m2", "residual_px", "visibility", "bone_lengths_m")


class Killed(BaseException):
    pass


def run(
    scene: Scene, folder: Path | None, config: fgpose.Config = CONFIG, last: int | None = None
) -> tuple[fgpose.Trajectory, list[int]]:
    """The result, and how many frames were done at each report; killed after so many reports."""
    told: list[int] = []

    def progress(done: int, _: int) -> None:
        told.append(done)
        if len(told) == last:
            raise Killed

    observations = scene.observations.frames(slice(0, 40))
    return fgpose.smooth(observations, scene.rig, config, progress, folder), told


def same(one: fgpose.Trajectory, other: fgpose.Trajectory) -> bool:
    arrays = all(np.array_equal(getattr(one, name), getattr(other, name), equal_nan=True) for name in ARRAYS)
    return arrays and one.convergence == other.convergence


def test_a_killed_run_goes_on_with_the_same_result(walking_scene: Scene, tmp_path: Path) -> None:
    whole, told = run(walking_scene, None)
    with pytest.raises(Killed):
        run(walking_scene, tmp_path, last=2)
    with pytest.warns(UserWarning, match=f"2 of {len(told)} windows were solved by a run that did not end"):
        resumed, told_again = run(walking_scene, tmp_path)
    assert told_again == told[1:]
    assert same(resumed, whole)
    # What is finished is not solved again either.
    with pytest.warns(UserWarning, match=f"{len(told)} of {len(told)} windows"):
        again, told_again = run(walking_scene, tmp_path)
    assert told_again == told[-1:]
    assert same(again, whole)


def test_a_window_that_a_power_cut_damaged_is_solved_again(walking_scene: Scene, tmp_path: Path) -> None:
    whole, told = run(walking_scene, None)
    with pytest.raises(Killed):
        run(walking_scene, tmp_path, last=2)
    first, _ = sorted(tmp_path.rglob("*.npz"))
    first.write_bytes(b"")
    again, told_again = run(walking_scene, tmp_path)
    assert told_again == told
    assert same(again, whole)


def test_other_settings_or_input_begin_anew(walking_scene: Scene, tmp_path: Path) -> None:
    with pytest.raises(Killed):
        run(walking_scene, tmp_path, last=1)
    with pytest.raises(Killed):
        run(walking_scene, tmp_path, config_from_dict({"solver": SOLVER, "projection": {"sigma_px": 7.0}}), last=1)
    later = walking_scene.rig.with_time_offsets(np.array([0.0, 0.01, 0.0, 0.0]))
    with pytest.raises(Killed):
        run(replace(walking_scene, rig=later), tmp_path, last=1)
    assert len(list(tmp_path.iterdir())) == 3
