"""Biases of detections: found where they are, not made up where there are none, and taken from the detections."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from jaxtyping import Float

import fgpose
from fgpose.config import Config
from fgpose.estimation.evidence.detection_bias import ResidualSums, RunningBias
from fgpose.estimation.evidence.evidence import Evidence
from fgpose.estimation.evidence.gather import gather
from fgpose.estimation.settling import informed
from fgpose.geometry.camera import CameraRig
from fgpose.skeleton import Skeleton
from fgpose_benchmarks.synthetic import DetectionNoise, Occlusion, Scene, motion_from_npz, simulate, walking
from tests.conftest import MOCAP

FPS = 50.0
SPREAD_M = np.full(4, 0.01)


def sums_of(error_m: np.ndarray, positions_m: np.ndarray, rig: CameraRig, count: float) -> ResidualSums:
    """Of detections that are off by so much along the axes of the image, each worth so many measurements."""
    measured_px = rig.project(positions_m) + rig.px_per_m(positions_m)[..., None] * error_m
    counts, on_time_m = np.full(measured_px.shape[:-1], count), np.zeros(positions_m.shape[:2])
    return ResidualSums.of(measured_px, positions_m, counts, on_time_m, rig)


def of_no_pose(bias_m: np.ndarray, positions_m: np.ndarray, rig: CameraRig) -> np.ndarray:
    """The part of biases that no move of the joints explains, at first order: an independent least squares solution."""
    step_m, left_m = 1e-6, np.empty_like(bias_m)
    for joint in range(positions_m.shape[1]):
        moved_px = [
            rig.project(positions_m[:1, joint : joint + 1] + step) - rig.project(positions_m[:1, joint : joint + 1])
            for step in step_m * np.eye(3)
        ]
        scale = rig.px_per_m(positions_m[:1, joint : joint + 1])[..., None]
        jacobian = np.stack([(moved / scale / step_m).reshape(-1) for moved in moved_px], axis=1)
        flat = bias_m[:, joint].reshape(-1)
        left_m[:, joint] = (flat - jacobian @ np.linalg.lstsq(jacobian, flat, rcond=None)[0]).reshape(-1, 2)
    return left_m


def test_with_enough_measurements_the_bias_is_what_no_move_of_the_joint_explains(
    rig: CameraRig, skeleton: Skeleton
) -> None:
    positions_m = np.repeat(walking(1, FPS, skeleton), 2, axis=0)
    bias_m = 0.02 * np.random.default_rng(0).normal(size=(4, 17, 2))
    sums = sums_of(bias_m, positions_m, rig, count=1e6)
    expected_m = of_no_pose(bias_m, positions_m, rig)
    # The variances of the cameras are re-estimated, and differ by chance: so do their shares of what is left, by 15 %.
    found_m = sums.bias(SPREAD_M).bias_m
    assert np.linalg.norm(found_m - expected_m) < 0.25 * np.linalg.norm(expected_m)
    # However it is shared, together with a move of the joint it explains everything.
    np.testing.assert_allclose(of_no_pose(found_m, positions_m, rig), expected_m, atol=1e-4)


def test_a_move_of_the_joint_is_no_bias(rig: CameraRig, skeleton: Skeleton) -> None:
    """Detections of a person who stands 3 cm beside."""
    positions_m = walking(1, FPS, skeleton)
    beside_m = positions_m + np.array([0.03, 0.0, 0.0])
    error_m = (rig.project(beside_m) - rig.project(positions_m))[0] / rig.px_per_m(positions_m)[0][..., None]
    bias_m = sums_of(error_m, positions_m, rig, count=1e6).bias(SPREAD_M).bias_m
    assert np.abs(bias_m).max() < 1e-3  # projection is not linear: 30 mm squared over 4 m


def test_the_camera_that_was_moved_has_the_bias(rig: CameraRig, skeleton: Skeleton) -> None:
    """The residuals alone do not tell which of the cameras is off by 4 cm: that all joints are in the same one does."""
    positions_m = walking(1, FPS, skeleton)
    error_m = np.zeros((4, 17, 2))
    error_m[2] = 0.04 * np.sign(np.random.default_rng(0).normal(size=(17, 2)))
    bias_m = sums_of(error_m, positions_m, rig, count=100.0).bias(SPREAD_M).bias_m
    assert np.linalg.norm(bias_m[2] - error_m[2]) < 0.35 * np.linalg.norm(error_m[2])
    others = np.linalg.norm(bias_m[[0, 1, 3]], axis=(1, 2))
    assert others.max() < 0.35 * np.linalg.norm(bias_m[2])  # equal shares would be 0.6


@pytest.mark.parametrize("count", [1.0, 4.0])
def test_noise_is_no_bias(count: float, rig: CameraRig, skeleton: Skeleton) -> None:
    """Of the mean of a few errors without bias less than half goes for bias."""
    positions_m = walking(1, FPS, skeleton)
    mean_m = SPREAD_M[0] / np.sqrt(count) * np.random.default_rng(1).normal(size=(4, 17, 2))
    bias_m = sums_of(mean_m, positions_m, rig, count).bias(SPREAD_M).bias_m
    assert np.linalg.norm(bias_m) < 0.5 * np.linalg.norm(mean_m)


def test_nothing_is_known_of_one_camera_or_of_none(rig: CameraRig, skeleton: Skeleton) -> None:
    positions_m = walking(1, FPS, skeleton)
    error_m = np.full((4, 17, 2), 0.05)
    sums = sums_of(error_m, positions_m, rig, count=100.0)
    alone = replace(sums, measurements=np.where(np.arange(4)[:, None] == 1, sums.measurements, 0.0))
    assert np.abs(alone.bias(SPREAD_M).bias_m).max() < 1e-4
    nothing = ResidualSums.none(4, 17).bias(SPREAD_M)
    np.testing.assert_array_equal(nothing.bias_m, 0.0)
    for bias in (alone.bias(SPREAD_M), nothing):
        np.testing.assert_array_equal(bias.common_share, 1.0)


def test_what_all_cameras_have_in_common_stays_unknown(rig: CameraRig, skeleton: Skeleton) -> None:
    """Of equally bad cameras all of it is left in the joints; of one bad camera the others know it."""
    positions_m, rng = walking(1, FPS, skeleton), np.random.default_rng(0)
    bias_m = 0.02 * rng.normal(size=(4, 17, 2))
    alike = sums_of(bias_m, positions_m, rig, count=1e6).bias(SPREAD_M)
    # The variances of the cameras come from some 20 numbers each, so they differ by chance: by 30 %.
    assert np.all(alike.common_share > 0.8)
    one_bad_m = np.where(np.arange(4)[:, None, None] == 1, 0.06, 0.003) * rng.normal(size=(4, 17, 2))
    one_bad = sums_of(one_bad_m, positions_m, rig, count=1e6).bias(SPREAD_M)
    # Three good cameras leave a few times their own variance, which is 0.01 of the mean one.
    assert np.all(one_bad.common_share < 0.1)


def test_cameras_that_all_stand_a_little_wrong_are_no_better_than_each_other(
    rig: CameraRig, skeleton: Skeleton
) -> None:
    """All joints of a camera are shifted alike: 34 numbers tell of its shift what 2 would. If they were independent,
    cameras whose shifts are small by chance would be taken for good ones, and the joints for better known by half."""
    positions_m, shares = walking(1, FPS, skeleton), []
    for seed in range(5):
        rng = np.random.default_rng(seed)
        error_m = 0.02 * rng.normal(size=(4, 1, 2)) + 0.005 * rng.normal(size=(4, 17, 2))
        shares.append(sums_of(error_m, positions_m, rig, count=1e4).bias(SPREAD_M).common_share)
    assert np.mean(shares) > 0.9  # 0.5 if all numbers were independent


def test_an_error_of_timing_tells_little_of_a_bias(rig: CameraRig, skeleton: Skeleton) -> None:
    positions_m = walking(1, FPS, skeleton)
    bias_m = 0.02 * np.random.default_rng(0).normal(size=(4, 17, 2))
    exact = sums_of(bias_m, positions_m, rig, count=100.0)
    timing = replace(exact, timing_m2=exact.measurements * 0.1**2)
    assert np.linalg.norm(timing.bias(SPREAD_M).bias_m) < 0.1 * np.linalg.norm(exact.bias(SPREAD_M).bias_m)


def test_running_biases_become_those_of_the_recording(rig: CameraRig, skeleton: Skeleton) -> None:
    positions_m = walking(1, FPS, skeleton)
    bias_m = 0.02 * np.random.default_rng(0).normal(size=(4, 17, 2))
    running, sums = RunningBias(4, 17), sums_of(bias_m, positions_m, rig, count=1.0)
    for _ in range(2000):  # 40 s: of the first, a quarter is forgotten
        running.add(sums, 1 / FPS, SPREAD_M)
    whole_m = sums_of(bias_m, positions_m, rig, count=2000.0).bias(SPREAD_M).bias_m
    np.testing.assert_allclose(running.bias.bias_m, whole_m, atol=1e-4)  # both have hundreds of measurements


def biased_scene(rig: CameraRig, skeleton: Skeleton) -> tuple[Scene, Float[np.ndarray, "camera joint 2"]]:
    """Half of the detections of three views occluded; each joint has its bias in each camera, 3 cm on average."""
    truth_m, fps = motion_from_npz(MOCAP / "cmu_02_05.npz")
    noise = DetectionNoise(correlated_px=2.0)
    scene = simulate(truth_m[:200], skeleton, rig, fps, noise, Occlusion(n_views=3), seed=0)
    bias_m = 0.025 * np.random.default_rng(0).normal(size=(4, 17, 2))
    bias_px = rig.px_per_m(truth_m[:200])[..., None] * bias_m
    observations = replace(scene.observations, points2d_px=scene.observations.points2d_px + bias_px)
    return replace(scene, observations=observations), bias_m


@pytest.mark.slow
def test_joints_do_not_jump_when_a_biased_camera_loses_them(rig: CameraRig, skeleton: Skeleton) -> None:
    """Batch and online: nearer to the truth, and less of the error changes with who sees the joint."""
    scene, _ = biased_scene(rig, skeleton)
    observations, truth_m = scene.observations.frames(slice(0, 125)), scene.truth_m[:125]
    error_mm, varying_mm = {}, {}
    for bias in ("none", "constant"):
        config = Config(visibility={"bias": bias}, solver={"covariance": False}, online={"covariance": False})
        estimator = fgpose.Estimator(rig, skeleton, config)
        for method, positions_m in {
            "batch": fgpose.smooth(observations, rig, config).positions_m,
            "online": np.stack([estimator.update(frame).positions_m for frame in observations]),
        }.items():
            off_mm = 1e3 * (positions_m - truth_m)[50:]  # online, biases are learned in the first second
            error_mm[method, bias] = np.linalg.norm(off_mm, axis=-1).mean()
            varying_mm[method, bias] = np.linalg.norm(off_mm - off_mm.mean(axis=0), axis=-1).mean()
    # 26 mm become 24, and online 30 become 28; what varies 14 and 10, online 20 and 18.
    for method, of_error, of_varying in (("batch", 0.93, 0.8), ("online", 0.95, 0.96)):
        assert error_mm[method, "constant"] < of_error * error_mm[method, "none"]
        assert varying_mm[method, "constant"] < of_varying * varying_mm[method, "none"]


@pytest.mark.slow
def test_what_was_taken_from_the_detections_is_kept(rig: CameraRig, skeleton: Skeleton) -> None:
    """The residuals of a result are those of the detections as they are, not of what the model makes of them."""
    scene, bias_m = biased_scene(rig, skeleton)
    config = Config()
    trajectory = fgpose.smooth(scene.observations, rig, config)
    evidence = gather(scene.observations, rig, config)
    known: Evidence = informed(evidence, trajectory.positions_m, rig, skeleton, config, trajectory.visibility)
    np.testing.assert_allclose(known.measured_px, evidence.undistorted_px, atol=1e-9)
    assert trajectory.residual_px is not None
    expected_px = np.linalg.norm(rig.project(trajectory.positions_m) - evidence.undistorted_px, axis=-1)
    np.testing.assert_allclose(trajectory.residual_px, expected_px, rtol=1e-6)  # they are kept in single precision
    found_m = known.bias_px[100] / rig.px_per_m(trajectory.positions_m[100])[..., None]
    # What no pose explains is 5 of 8 parts of the biases; what is found of that correlates with the truth.
    assert np.corrcoef(found_m.ravel(), bias_m.ravel())[0, 1] > 0.6
