"""Time offsets of the cameras, learned frame by frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fgpose
from fgpose.config import CalibrationConfig, Config
from fgpose.estimation.online.clock_offsets import RunningOffsets
from fgpose_benchmarks.synthetic import NO_OCCLUSION, DetectionNoise, Scene, simulate, walking

KNOWN_S = np.array([0.0, 0.2, -0.1, 0.05])
FPS = 50.0
UNIFORM = np.ones((4, 17))
SIGMA_PX = np.full((4, 17), 6.0)
LATE_S = np.array([0.0, 0.03, -0.02, 0.01])


def test_offsets_that_are_known_stay_where_nobody_moves(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> None:
    """The prior is around what the rig says, not around zero."""
    rig = rig.with_time_offsets(KNOWN_S)
    offsets, standing_m = RunningOffsets(rig, Config()), walking(1, FPS, skeleton)[0]
    for frame in range(20):
        offsets.add(
            frame / FPS, 1 / FPS, standing_m, np.zeros_like(standing_m), rig.project(standing_m), UNIFORM, SIGMA_PX, rig
        )
    np.testing.assert_allclose(offsets.rig().time_offsets_s, KNOWN_S, atol=1e-12)


@pytest.mark.parametrize("sigma_s", [0.1, 0.002])
def test_offsets_of_a_moving_person(sigma_s: float, rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> None:
    """Found where the prior is weak; where it is strong, between what is known and what is seen."""
    config = Config(calibration=CalibrationConfig(offset_sigma_s=sigma_s))
    offsets, motion_m = RunningOffsets(rig, config), walking(60, FPS, skeleton)
    velocities_mps = np.gradient(motion_m, 1 / FPS, axis=0)
    late_s = np.array([0.0, 0.01, -0.01, 0.0])
    for frame, (position_m, velocity_mps) in enumerate(zip(motion_m, velocities_mps, strict=True)):
        seen_px = rig.project_each(position_m + late_s[:, None, None] * velocity_mps)
        offsets.add(frame / FPS, 1 / FPS, position_m, velocity_mps, seen_px, UNIFORM, SIGMA_PX, rig)
    found_s = offsets.rig().time_offsets_s
    assert found_s[0] == 0.0
    if sigma_s == 0.1:
        # 17 joints at 1.2 m/s for 1.2 s know an offset to about 2 ms: the prior of 100 ms takes 0.04 %. The rest is
        # the kernel and the curvature of the projection.
        np.testing.assert_allclose(found_s, late_s, atol=5e-4)
    else:
        assert 0.1 * 0.01 < found_s[1] < 0.9 * 0.01


def fed(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton, late_s: np.ndarray, n_people: int) -> RunningOffsets:
    """The same walk of each of these people, in all of whose images these cameras are late."""
    offsets, motion_m = RunningOffsets(rig, Config()), walking(60, FPS, skeleton)
    offsets.sigma_s = np.full(rig.n_cameras, 0.1)
    for frame, (position_m, velocity_mps) in enumerate(
        zip(motion_m, np.gradient(motion_m, 1 / FPS, axis=0), strict=True)
    ):
        seen_px = rig.project_each(position_m + late_s[:, None, None] * velocity_mps)
        for _ in range(n_people):
            offsets.add(frame / FPS, 1 / FPS, position_m, velocity_mps, seen_px, UNIFORM, SIGMA_PX, rig)
    return offsets


def test_several_people_tell_more_and_are_remembered_as_long(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> None:
    late_s = np.array([0.0, 0.01, -0.01, 0.0])
    one, three = (fed(rig, skeleton, late_s, n).evidence for n in (1, 3))
    # Seconds of three people contradict each other three times as clearly, by the kernel and the curvature alone.
    np.testing.assert_allclose(three.information, 3 * one.information, rtol=1e-4)
    np.testing.assert_allclose(three.moment, 3 * one.moment, rtol=1e-4)


def test_what_all_cameras_have_in_common_is_not_told(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> None:
    offsets = fed(rig, skeleton, np.array([0.03, 0.01, -0.01, 0.01]), 1)
    change_s, sigma_s = offsets.relative()
    # As above: the kernel, and the curvature of the projection.
    np.testing.assert_allclose(change_s, [0.02, 0.0, -0.02, 0.0], atol=1e-3)
    # Far below what is known of each by itself: the prior of 0.1 s, that all four have in common, is 0.05 s. Detections
    # are at the times of the rig, up to 20 ms off, which is more than their errors.
    assert (sigma_s < 0.01).all()
    assert (offsets.relative(fits=True)[1] < 0.005).all()
    assert (np.abs(change_s) < 5 * sigma_s + 0.02).all()


def test_cameras_with_this_computers_clock_are_held(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> None:
    offsets = fed(rig, skeleton, np.array([0.0, 0.01, -0.01, 0.0]), 1)
    offsets.sigma_s = np.array([0.0, 0.1, 0.002, 0.0])
    change_s, sigma_s = offsets.relative()
    assert (change_s[[0, 3]] == 0).all()
    assert (sigma_s[[0, 3]] == 0).all()
    np.testing.assert_allclose(change_s[1], 0.01, atol=1e-3)
    # Between what is known and what is seen.
    assert -0.009 < change_s[2] < -0.0005
    np.testing.assert_array_equal(offsets.rig().time_offsets_s, change_s)


def test_evidence_from_elsewhere_counts(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> None:
    late_s = np.array([0.0, 0.01, -0.01, 0.0])
    both, here = fed(rig, skeleton, late_s, 2), fed(rig, skeleton, late_s, 1)
    here.elsewhere = fed(rig, skeleton, late_s, 1).evidence
    np.testing.assert_allclose(here.rig().time_offsets_s, both.rig().time_offsets_s, atol=1e-9)
    np.testing.assert_allclose(here.relative(), both.relative(), rtol=1e-4, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(("sigma_px", "within_s"), [(2.0, 2e-3), (15.0, 30e-3)])
def test_offsets_are_as_uncertain_as_the_detections(
    sigma_px: float, within_s: float, mocap_scene: Scene, rig: fgpose.CameraRig, skeleton: fgpose.Skeleton
) -> None:
    """The spread of detections is learned; errors of velocities, which shrink offsets, are those one lag later."""
    noise = DetectionNoise(sigma_px=sigma_px, correlated_px=0.0, outlier_share=0.0)
    truth_m = mocap_scene.truth_m[:75]
    seen = simulate(truth_m, skeleton, rig, FPS, noise, NO_OCCLUSION, seed=0, offsets_s=LATE_S).observations
    estimator = fgpose.Estimator(rig, skeleton, Config(online={"estimate_time_offsets": True}))
    for frame in replace(seen, points3d_m=None, covariance3d_m2=None):
        estimator.update(frame)
    change_s, sigma_s = estimator._body._offsets.relative()
    error_s = change_s[1:] - LATE_S[1:]
    assert np.abs(error_s).max() < within_s
    # The 99.9 % quantile of chi-square with three degrees of freedom.
    assert np.sum((error_s / sigma_s[1:]) ** 2) < 16.3


@pytest.mark.slow
@pytest.mark.parametrize("late_s", [0.2, -0.2, 0.3, -0.3])
def test_an_offset_far_beyond_the_prior_is_not_known_well(
    late_s: float, mocap_scene: Scene, rig: fgpose.CameraRig, skeleton: fgpose.Skeleton
) -> None:
    """Where detections are far off they count as outliers, and those of who hardly moves agree with any offset: the
    standard deviation that these had was a fifth of the error, and less."""
    noise = DetectionNoise(sigma_px=2.0, correlated_px=0.0, outlier_share=0.0)
    truth_m = mocap_scene.truth_m[:150]
    offsets_s = np.array([0.0, late_s, 0.0, 0.0])
    seen = simulate(truth_m, skeleton, rig, FPS, noise, NO_OCCLUSION, seed=0, offsets_s=offsets_s).observations
    estimator = fgpose.Estimator(rig, skeleton, Config(online={"estimate_time_offsets": True}))
    for frame in replace(seen, points3d_m=None, covariance3d_m2=None):
        estimator.update(frame)
    change_s, sigma_s = estimator._body._offsets.relative()
    assert np.abs((change_s - offsets_s)[1:] / sigma_s[1:]).max() < 3.3  # 99.9 %
