"""Images that are given together although they were taken far apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fgpose
from fgpose.estimation.online.arrivals import TooLateError
from fgpose.estimation.online.one_moment import taken_together
from fgpose.people_observations import Detections
from fgpose_benchmarks.synthetic import NO_OCCLUSION, DetectionNoise, Scene, motion_from_npz, simulate
from tests.conftest import MOCAP

LATE = 9  # frames at 25 Hz
ELLIPSOID = 7.815  # of 95 %, three degrees of freedom


@pytest.mark.parametrize(
    ("taken_s", "step_s", "expected"),
    [
        ([0.0, 0.3, 0.01, 0.02], 0.03, [True, False, True, True]),
        ([0.0, np.nan, 0.3, 0.31], 0.03, [False, False, True, True]),
        ([0.3, 0.0, 0.3, 0.0], 0.03, [False, True, False, True]),
        ([0.0, 0.08, 0.05, 0.02], 0.03, [True, True, True, True]),
        ([0.0, 0.18, 0.05, 0.1], 0.2, [True, True, True, True]),
    ],
    ids=["one late", "one early, one missing", "two and two", "near", "within one step of slow cameras"],
)
def test_the_most_that_were_taken_together_are_kept(taken_s: list[float], step_s: float, expected: list[bool]) -> None:
    together = taken_together(np.array(taken_s), step_s)
    np.testing.assert_array_equal(together, expected)


@pytest.fixture(scope="module")
def late(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> Scene:
    """Every image of the second camera was taken 0.36 s after those given with it, as its time says."""
    truth_m, fps = motion_from_npz(MOCAP / "cmu_02_10.npz")
    truth_m, fps = truth_m[:200:2], fps / 2
    scene = simulate(truth_m, skeleton, rig, fps, DetectionNoise(), NO_OCCLUSION, seed=0)
    seen, n = scene.observations, len(truth_m) - LATE
    points2d_px, confidence = seen.points2d_px[:n].copy(), seen.confidence[:n].copy()
    points2d_px[:, 1], confidence[:, 1] = seen.points2d_px[LATE:, 1], seen.confidence[LATE:, 1]
    time_s = np.repeat(seen.frame_time_s[:n, None], rig.n_cameras, axis=1)
    time_s[:, 1] = seen.frame_time_s[LATE:]
    observations = fgpose.Observations(skeleton, time_s, points2d_px, confidence, camera_names=rig.names)
    return replace(scene, observations=observations, truth_m=truth_m[:n])


def share_in_ellipsoids(estimates: list[fgpose.Estimate], truth_m: np.ndarray) -> float:
    error_m = np.stack([each.positions_m for each in estimates]) - truth_m
    covariance_m2 = np.stack([each.covariance_m2 for each in estimates if each.covariance_m2 is not None])
    squared = np.einsum("tji,tjik,tjk->tj", error_m, np.linalg.inv(covariance_m2), error_m)
    return float(np.mean(squared < ELLIPSOID))


@pytest.mark.parametrize("solver", ["window", pytest.param("isam2", marks=pytest.mark.slow)])
def test_a_frame_is_estimated_from_the_images_of_one_moment(late: Scene, solver: str) -> None:
    """Shifted by the motion over 0.36 s that they tell themselves, the images drove the pose metres away."""
    estimator = fgpose.Estimator(late.rig, late.observations.skeleton, fgpose.Config(online={"solver": solver}))
    with pytest.warns(UserWarning, match=f"those of camera {late.rig.names[1]} 0.36 s after the others") as told:
        estimates = [estimator.update(frame) for frame in late.observations]
    assert len(told) == 1
    np.testing.assert_allclose([each.time_s for each in estimates], late.observations.time_s[:, 0])
    settled = slice(15, None)
    error_m = np.linalg.norm(np.stack([each.positions_m for each in estimates]) - late.truth_m, axis=-1)
    # 20 mm on average with three cameras.
    assert error_m[settled].mean() < 0.03
    assert share_in_ellipsoids(estimates[settled], late.truth_m[settled]) > 0.9


def test_time_still_increases(late: Scene) -> None:
    estimator = fgpose.Estimator(late.rig, late.observations.skeleton, fgpose.Config(online={"solver": "window"}))
    frames = list(late.observations)
    with pytest.warns(UserWarning, match="taken far apart"):
        estimator.update(frames[4])
    with pytest.raises(TooLateError, match="time must increase"):
        estimator.update(frames[3])


def test_a_tracker_leaves_them_out(late: Scene) -> None:
    """Nobody was ever confirmed."""
    names, seen = late.rig.names, late.observations
    config = fgpose.Config(online={"solver": "window"}, tracking={"max_processes": 1})
    tracker = fgpose.Tracker(late.rig, seen.skeleton, config)
    moments = [
        [Detections(*image) for image in zip(names, time_s, points2d_px[:, None], confidence[:, None], strict=True)]
        for points2d_px, confidence, time_s in zip(seen.points2d_px, seen.confidence, seen.time_s.tolist(), strict=True)
    ]
    with pytest.warns(UserWarning, match="taken far apart") as told:
        people = [tracker.update(images) for images in moments][-1]
    assert len(told) == 1
    assert len(people) == 1
    assert np.linalg.norm(people[0].estimate.positions_m - late.truth_m[-1], axis=-1).mean() < 0.05
