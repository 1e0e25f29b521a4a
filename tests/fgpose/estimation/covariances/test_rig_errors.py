"""Covariances where a camera is not where the calibration has it, and with the errors of real detectors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

import fgpose
from fgpose.geometry.camera import CameraRig
from fgpose_benchmarks.synthetic import (
    NO_OCCLUSION,
    DetectionNoise,
    Scene,
    motion_from_npz,
    real_errors,
    ring_rig,
    simulate,
)
from tests.conftest import MOCAP
from tests.wrong_rigs import turned


def scene(rig: CameraRig, skeleton: fgpose.Skeleton, source: str | None = None, n_frames: int = 125) -> Scene:
    """Of five seconds, at half of the rate of the motion capture."""
    truth_m, fps = motion_from_npz(MOCAP / "cmu_03_03_b.npz")
    truth_m, fps = truth_m[: 2 * n_frames : 2], fps / 2
    rng = np.random.default_rng(0)
    real = real_errors(rng, len(truth_m), rig.n_cameras, skeleton, fps, (source,)) if source else None
    return simulate(truth_m, skeleton, rig, fps, DetectionNoise(), NO_OCCLUSION, seed=0, real=real)


def squared(positions_m: np.ndarray, covariance_m2: np.ndarray | None, truth_m: np.ndarray) -> np.ndarray:
    """Normalised estimation errors."""
    assert covariance_m2 is not None
    error_m = positions_m - truth_m
    return np.einsum("...ji,...jik,...jk->...j", error_m, np.linalg.inv(covariance_m2), error_m)


def batch(filmed: Scene, rig: CameraRig) -> np.ndarray:
    trajectory = fgpose.smooth(replace(filmed.observations, points3d_m=None, covariance3d_m2=None), rig)
    return squared(trajectory.positions_m, trajectory.covariance_m2, filmed.truth_m)


def online(filmed: Scene, rig: CameraRig) -> np.ndarray:
    estimator = fgpose.Estimator(rig, filmed.observations.skeleton)
    observations = replace(filmed.observations, points3d_m=None, covariance3d_m2=None)
    estimates = [estimator.update(frame) for frame in observations]
    return np.stack(
        [squared(e.positions_m, e.covariance_m2, t) for e, t in zip(estimates, filmed.truth_m, strict=True)]
    )


def within(squared: np.ndarray, share: float) -> float:
    return float(np.mean(squared < chi2.ppf(share, 3)))


@pytest.mark.parametrize(
    "axis",
    [pytest.param([1.0, 0.0, 0.0], id="tilted", marks=pytest.mark.slow), pytest.param([0.0, 1.0, 0.0], id="panned")],
)
def test_the_covariance_holds_what_a_turned_camera_does(
    axis: list[float], rig: CameraRig, skeleton: fgpose.Skeleton
) -> None:
    """Three cameras contradict a pan in a few centimetres only; it moves all joints by more than a decimetre."""
    three = rig.subset(rig.names[:3])
    filmed = scene(turned(three, 1, 2.0, axis), skeleton)
    found = batch(filmed, three)
    # One turn is one error, and frames differ in what contradicts it: 83 and 95 % panned; without, 1 and 2 %.
    assert within(found, 0.9) > 0.7
    assert within(found, 0.99) > 0.9


def test_covariances_hold_the_errors_of_real_detectors(rig: CameraRig, skeleton: fgpose.Skeleton) -> None:
    """Five seconds hold a few hundred independent errors of 17 joints, most of which last: five points, and half of
    them are smaller than in other seconds."""
    found = batch(scene(rig, skeleton, "blazepose_heavy"), rig)
    assert within(found, 0.5) == pytest.approx(0.5, abs=0.11)
    assert within(found, 0.9) == pytest.approx(0.9, abs=0.06)
    assert within(found, 0.99) == pytest.approx(0.99, abs=0.02)


@pytest.mark.slow
def test_online_covariances_hold_the_errors_of_real_detectors(rig: CameraRig, skeleton: fgpose.Skeleton) -> None:
    """As they are learned: in the first second nothing is known of them, in three 75 and 89 % are within."""
    found = online(scene(rig, skeleton, "blazepose_heavy", n_frames=75), rig)
    assert within(found, 0.9) > 0.68
    assert within(found, 0.99) > 0.85


@pytest.mark.slow
@pytest.mark.parametrize("apart", [1, 2])
def test_online_covariances_of_two_cameras_hold_the_errors_of_real_detectors(
    apart: int, skeleton: fgpose.Skeleton
) -> None:
    """They contradict each other vertically alone. From the second second on 86 and 95 % are within at 45 degrees, 88
    and 97 % at 90; with one factor for all directions it was 76 and 92, 83 and 95 %."""
    eight = ring_rig(8, 5.0, 2.5, (0.0, 0.0, 0.9), focal_px=900.0, size_px=(1600, 1200))
    two = eight.subset([eight.names[0], eight.names[apart]])
    found = online(scene(two, skeleton, "blazepose_heavy"), two)[25:]
    assert within(found, 0.9) > 0.84
    assert within(found, 0.99) > 0.94
