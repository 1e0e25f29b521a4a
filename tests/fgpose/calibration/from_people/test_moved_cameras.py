"""Cameras that were moved while a calibration was filmed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from adjusted_rigs import FPS, moved, walker

from fgpose.calibration.from_people.verdict.alignment import aligned
from fgpose.calibration.from_people.verdict.moved_cameras import MovedCamera, MovedMidway, moved_camera, moved_midway
from fgpose.calibration.from_people.verdict.sigmas import RigEstimate, camera_sigmas
from fgpose.geometry.camera import CameraRig
from fgpose_benchmarks.synthetic import ring_rig

RIG = ring_rig(4, 4.5, 1.7, (0.0, 0.0, 0.9))
AT_S, UP_PX = 15.0, 60.0


def found(rig: CameraRig, up_px: float, duration_s: float = 20.0) -> MovedCamera | None:
    """Of somebody who is seen with 2 px of error, by cameras of which the second looks up after three quarters."""
    truth_m, skeleton = walker(duration_s, 0)
    time_s = np.arange(len(truth_m)) / FPS
    px = rig.project(truth_m) + np.random.default_rng(0).normal(0, 2.0, (len(truth_m), rig.n_cameras, 1, 2))
    px[time_s >= 0.75 * duration_s, 1, :, 1] += up_px
    return moved_camera(time_s, px, np.ones((len(px), rig.n_cameras, skeleton.n_joints)), rig)


def test_a_camera_that_is_turned_in_the_last_quarter_is_named() -> None:
    moved = found(RIG, UP_PX)
    assert moved is not None
    assert moved.camera == 1
    assert moved.from_s == pytest.approx(AT_S, abs=2.5)  # told in parts of that length
    assert moved.to_s == pytest.approx(20.0, abs=1.5 / FPS)
    assert moved.mrad == pytest.approx(1e3 * UP_PX / RIG.cameras[1].K[1, 1], rel=0.1)
    assert moved.usual_mrad < 5.0


def test_of_two_cameras_it_is_not_clear_which_one() -> None:
    moved = found(RIG.subset(RIG.names[:2]), UP_PX)
    assert moved is not None
    assert moved.camera is None


def test_cameras_that_stand_still_were_not_moved_and_little_tells_nothing() -> None:
    assert found(RIG, 0.0) is None
    assert found(RIG, UP_PX, 9.0) is None


def midway(whole_errors: np.ndarray) -> MovedMidway | None:
    """Of a recording whose halves are a few millimetres apart, and whose whole has these errors."""
    apart = np.random.default_rng(1).normal(0, 1, (4, 6)) * np.repeat([0.001, 0.005], 3)
    ones = np.ones(4)
    whole = RigEstimate(moved(RIG, whole_errors), 1e-6 * np.eye(24).reshape(4, 6, 4, 6), 0 * ones, 0 * ones)
    halves = [replace(whole, rig=moved(RIG, sign * apart)) for sign in (1, -1)]
    sigmas = camera_sigmas(whole, (halves[0], halves[1]), 0.0, 0.0, 0.0)
    if whole_errors.any():
        # What the halves do not show: the whole is off by it.
        off = aligned(whole.rig, RIG)[1]
        assert (np.linalg.norm(off[:, 3:], axis=1) < 1.5 * sigmas.position_m).all()
    return moved_midway((halves[0].rig, halves[1].rig), whole.rig, sigmas)


def test_a_whole_that_agrees_with_neither_half_was_moved_in_the_middle() -> None:
    errors = np.zeros((4, 6))
    errors[1] = (0.0, 0.03, 0.0, 0.08, 0.0, 0.0)
    found_midway = midway(errors)
    assert found_midway is not None
    assert found_midway.whole_m > 2 * found_midway.halves_m
    assert midway(np.zeros((4, 6))) is None
