"""Somebody a metre away from the cameras: detectors err by as many centimetres as four metres away, which are more
pixels."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

import fgpose
from fgpose.trajectory import Status
from fgpose_benchmarks.synthetic import ring_rig, walking

SKELETON = fgpose.load_skeleton("h36m_17")
HIP = SKELETON.index("left_hip")
FPS, SIGMA_M = 30.0, 0.015


def filmed(radius_m: float, off_m: float) -> tuple[fgpose.Observations, fgpose.CameraRig, np.ndarray]:
    """By two cameras, of which one sees the hip lower, the other one higher; and the truth. Detections err by as much
    at the body, wherever the cameras are. The body walks on the spot."""
    truth_m = walking(45, FPS, SKELETON)
    truth_m[..., :2] -= truth_m[:, :1, :2]
    size_px, focal_px = (4000, 4000), 286.25 * radius_m
    rig = ring_rig(radius_m=radius_m, height_m=1.2, focal_px=focal_px, size_px=size_px).subset(["ring_0", "ring_1"])
    rng, points_px = np.random.default_rng(0), []
    for camera, upwards in zip(rig.cameras, (-0.5, 0.5), strict=True):
        shown_m = truth_m + rng.normal(0.0, SIGMA_M, truth_m.shape)
        shown_m[:, HIP, 2] += upwards * off_m
        points_px.append(camera.project(shown_m))
    points2d_px = np.stack(points_px, axis=1)
    return fgpose.Observations(SKELETON, np.arange(45) / FPS, points2d_px, camera_names=rig.names), rig, truth_m


def estimated(observations: fgpose.Observations, rig: fgpose.CameraRig, how: str) -> fgpose.Trajectory:
    if how == "batch":
        return fgpose.smooth(observations, rig)
    estimator = fgpose.Estimator(rig, SKELETON)
    return fgpose.Trajectory.from_estimates([estimator.update(frame) for frame in observations], rig.names)


@pytest.mark.parametrize("how", ["batch", "online"])
@pytest.mark.parametrize("radius_m", [1.0, 4.0])
def test_a_joint_on_which_two_views_agree_to_a_decimetre_is_given(radius_m: float, how: str) -> None:
    """At 1 m it was NaN in all frames, at 4 m it was given: 45 mm are 13 px at 4 m and 52 px at 1 m."""
    observations, rig, truth_m = filmed(radius_m, 0.09)
    trajectory = estimated(observations, rig, how)
    assert trajectory.covariance_m2 is not None
    known = trajectory.status != Status.UNOBSERVABLE
    # Online, the first frames tell what is known of the bones.
    assert known[5:].all()
    error_m = (trajectory.positions_m - truth_m)[5:, HIP]
    inverse = np.linalg.inv(trajectory.covariance_m2[5:, HIP].astype(float))
    squared = np.einsum("ti,tij,tj->t", error_m, inverse, error_m)
    # Each of the rays may be the right one, 45 mm from the middle between them.
    assert np.linalg.norm(error_m, axis=-1).mean() < 0.045
    assert np.mean(squared < chi2.ppf(0.95, 3)) > 0.95


def test_a_joint_that_two_views_show_two_decimetres_apart_is_not_said_to_be_seen() -> None:
    observations, rig, _ = filmed(1.0, 0.2)
    trajectory = estimated(observations, rig, "batch")
    assert not (trajectory.status[:, HIP] == Status.OBSERVED).any()
