"""Whatever an estimator refuses leaves it as it was, and it refuses no data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest

import fgpose
from fgpose.io.skeletons import load_skeleton
from fgpose_benchmarks.synthetic import NO_NOISE, NO_OCCLUSION, simulate, walking
from tests.states import state_of

FAST = fgpose.Config(online={"covariance": False, "lag_s": 0.2})
FPS = 25.0
Refused = Callable[[fgpose.Estimator, fgpose.Observations], object]


@pytest.fixture(scope="module")
def seen(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> fgpose.Observations:
    return simulate(walking(12, FPS), skeleton, rig, FPS, NO_NOISE, NO_OCCLUSION, seed=0).observations


def frame_of(seen: fgpose.Observations, number: int, time_s: float) -> fgpose.Observations:
    return replace(seen.frames(slice(number, number + 1)), time_s=np.array([time_s]))


def arrays(seen: fgpose.Observations, **changes: Any) -> dict[str, Any]:
    return {"time_s": 1.0, "points2d_px": seen.points2d_px[9], "confidence": seen.confidence[9]} | changes


def image(seen: fgpose.Observations, camera: str, time_s: float, **changes: Any) -> dict[str, Any]:
    own = {"points2d_px": seen.points2d_px[9, 0], "confidence": seen.confidence[9, 0]}
    return {"camera": camera, "time_s": time_s} | own | changes


"""By what is said of it."""
REFUSED: dict[str, Refused] = {
    "one frame at a time": lambda e, s: e.update(s.frames(slice(8, 10))),
    "got a frame at 0.12 s after one at 0.12 s": lambda e, s: e.update(s.frames(slice(3, 4))),
    "got a frame at 0.05 s": lambda e, s: e.update(frame_of(s, 9, 0.05)),
    "a, b, c, d|camera a": lambda e, s: e.update(replace(frame_of(s, 9, 1.0), camera_names=tuple("abcd"))),
    "skeleton coco_17": lambda e, s: e.update(
        fgpose.Observations(load_skeleton("coco_17"), np.ones(1), s.points2d_px[9:10], camera_names=s.camera_names)
    ),
    "infinite": lambda e, s: e.update_arrays(**arrays(s, points2d_px=np.full_like(s.points2d_px[9], np.inf))),
    "outside": lambda e, s: e.update_arrays(**arrays(s, confidence=2.0)),
    "time_s": lambda e, s: e.update_arrays(**arrays(s, time_s=np.nan)),
    "millimetres": lambda e, s: e.update_arrays(**arrays(s, points3d_m=np.full((*s.points2d_px[9].shape[:2], 3), 1e3))),
    "no camera 'door'; it has ring_0, ": lambda e, s: e.update_camera(**image(s, "door", 1.0)),
    "no camera 0; it has ring_0, ": lambda e, s: e.update_camera(**image(s, cast("str", 0), 1.0)),
    "gave an image at 0.12 s before": lambda e, s: e.update_camera(**image(s, e.rig.names[0], 3 / FPS)),
    "(?i)time": lambda e, s: e.update_camera(**image(s, e.rig.names[0], np.nan)),
}


def test_what_is_refused_changes_nothing(rig: fgpose.CameraRig, seen: fgpose.Observations) -> None:
    estimator = fgpose.Estimator(rig, seen.skeleton, FAST)
    for frame in list(seen)[:4]:
        estimator.update(frame)
    before = state_of(estimator)
    for what, refused in REFUSED.items():
        with pytest.raises(ValueError, match=what):
            refused(estimator, seen)
    assert state_of(estimator) == before


def test_an_image_that_is_older_than_the_window_changes_nothing(
    rig: fgpose.CameraRig, seen: fgpose.Observations
) -> None:
    """The first of its camera; that of one that has gone on until now is of a clock that was set (ClockSteps)."""
    estimator = fgpose.Estimator(rig, seen.skeleton, FAST)
    for frame in list(seen)[:4]:
        estimator.update(frame.subset(list(rig.names[1:])))
    before = state_of(estimator)
    with pytest.raises(ValueError, match="waits for its image"):
        estimator.update_camera(**image(seen, rig.names[0], -1.0))
    assert state_of(estimator) == before


def test_a_rig_in_millimetres_is_refused_without_a_change(rig: fgpose.CameraRig, seen: fgpose.Observations) -> None:
    scale = np.diag([1e3, 1e3, 1e3, 1.0])
    cameras = [
        replace(each, world_T_camera=np.c_[each.world_T_camera[:, :3], scale @ each.world_T_camera[:, 3]])
        for each in rig.cameras
    ]
    estimator = fgpose.Estimator(fgpose.CameraRig(tuple(cameras)), seen.skeleton, FAST)
    for frame in list(seen)[:9]:
        estimator.update(frame)
    before = state_of(estimator)
    with pytest.raises(ValueError, match="millimetres"):
        estimator.update(seen.frames(slice(9, 10)))
    assert state_of(estimator) == before


def test_two_joints_that_meet_far_away_are_data(rig: fgpose.CameraRig, seen: fgpose.Observations) -> None:
    """From the first image on: nobody is whole in view yet, and two cameras side by side hallucinate the same."""
    camera = rig.cameras[0]
    aside = camera.world_T_camera.copy()
    aside[:3, 3] += 3 * aside[:3, 0]
    pair = fgpose.CameraRig((camera, replace(camera, name="aside", world_T_camera=aside)))
    joints_m = np.full((seen.skeleton.n_joints, 3), np.nan)
    joints_m[:2] = camera.position_m + np.array([5, 90])[:, None] * camera.world_T_camera[:3, 2]
    estimator = fgpose.Estimator(pair, seen.skeleton, FAST)
    for frame in range(12):
        assert estimator.update_arrays(frame / FPS, pair.project(joints_m)).frame == frame
