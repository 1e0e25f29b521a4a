"""Cameras that were moved while a calibration was filmed."""

from __future__ import annotations

import numpy as np
import pytest
from adjusted_rigs import FPS, walker

from fgpose.calibration.from_people.verdict.moved_cameras import MovedCamera, moved_camera
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
