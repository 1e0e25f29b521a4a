"""What the views of a frame contradict each other by, and what it says for the errors of detections."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fgpose
from fgpose.config import Config
from fgpose.estimation.evidence.gather import gather
from fgpose.estimation.visibility.detection_residuals import DetectionResiduals
from fgpose.estimation.visibility.spread import Contradictions, spread_m
from fgpose.geometry.camera import CameraRig
from fgpose.skeleton import Skeleton
from fgpose_benchmarks.synthetic import NO_OCCLUSION, DetectionNoise, Scene, embedded_motion, simulate, walking

FPS = 30.0
CONFIG = Config()


def noisy(rig: CameraRig, skeleton: Skeleton, sigma_px: float, n_frames: int = 150) -> Scene:
    noise = DetectionNoise(sigma_px=sigma_px, correlated_px=0.0, outlier_share=0.0)
    return simulate(walking(n_frames, FPS, skeleton), skeleton, rig, FPS, noise, NO_OCCLUSION, seed=0)


def residuals_of(positions_m: np.ndarray, scene: Scene, rig: CameraRig) -> DetectionResiduals:
    """Of detections that count alike, whatever their confidence."""
    evidence = gather(scene.observations, rig, CONFIG)
    return DetectionResiduals.of(positions_m, replace(evidence, weights=np.ones_like(evidence.weights)), rig, CONFIG)


def seen_by(contradictions: Contradictions, n_cameras: int) -> Contradictions:
    information = contradictions.information.copy()
    information[:, n_cameras:] = 0.0
    return replace(contradictions, information=information)


@pytest.mark.parametrize("n_cameras", [2, 3, 4])
def test_a_position_takes_three_degrees_of_freedom(n_cameras: int, rig: CameraRig, skeleton: Skeleton) -> None:
    scene = noisy(rig, skeleton, 3.0, n_frames=3)
    found = seen_by(residuals_of(scene.truth_m, scene, rig).contradictions, n_cameras)
    freedom = np.where(found.information > 0, found.freedom, 0.0).sum(axis=1)
    # Three directions are known to centimetres, besides to a metre anyhow: 1e-3.
    np.testing.assert_allclose(freedom, 2 * n_cameras - 3, atol=5e-3)


def test_one_view_contradicts_nothing(rig: CameraRig, skeleton: Skeleton) -> None:
    scene = noisy(rig, skeleton, 3.0, n_frames=3)
    assert not seen_by(residuals_of(scene.truth_m, scene, rig).contradictions, 1).tells.any()


@pytest.mark.parametrize("n_cameras", [2, 4])
def test_half_of_normal_errors_say_less(n_cameras: int, rig: CameraRig, skeleton: Skeleton) -> None:
    scene = noisy(rig, skeleton, 4.0)
    found = seen_by(residuals_of(scene.truth_m, scene, rig).contradictions, n_cameras)
    single_px = (found.single_spread_m * found.px_per_m)[found.tells]
    # 2,550 joints: 1 %. What the kernel leaves is taken for 0.9 and is up to 0.98; the density of the logarithm of the
    # lengths is 0.7.
    assert np.mean(single_px < 4.0) == pytest.approx(0.5, abs=0.08)


def test_a_pose_that_is_off_changes_nothing(rig: CameraRig, skeleton: Skeleton) -> None:
    """All views see a joint that moves more roughly than was expected off its path: that is no error of theirs."""
    scene = noisy(rig, skeleton, 3.0)
    off_m = np.random.default_rng(0).normal(scale=0.03, size=scene.truth_m.shape)
    at_truth, off = (residuals_of(positions_m, scene, rig) for positions_m in (scene.truth_m, scene.truth_m + off_m))

    def by_both(residuals: DetectionResiduals) -> np.ndarray:
        measures = zip(residuals.single_spread_m, residuals.tells, strict=True)
        return np.array([spread_m(*measure, residuals.weights, CONFIG.visibility.sigma_m, 1.0) for measure in measures])

    (of_pose_m, of_views_m), (own_m, others_m) = by_both(off), by_both(at_truth)
    assert (of_pose_m > 2 * own_m).all()
    # The robust kernel does not weight all views alike any more: 1 to 3 %.
    np.testing.assert_allclose(of_views_m, others_m, rtol=0.05)
    np.testing.assert_array_equal(off.spread_m(CONFIG.visibility.sigma_m, 1.0), of_views_m)


def test_a_motion_that_is_faster_than_expected_is_not_taken_for_errors(rig: CameraRig, skeleton: Skeleton) -> None:
    """Two thirds of a second of somebody who runs at 12 m/s, seen by three cameras to 1.5 px."""
    motion_m, _ = embedded_motion("cmu_02_03_short")
    three, noise = rig.subset(rig.names[:3]), DetectionNoise(sigma_px=1.5, correlated_px=0.0, outlier_share=0.0)
    truth_m = motion_m[:60:3] - motion_m[:60:3].mean(axis=(0, 1)) * (1, 1, 0)
    observations = simulate(truth_m, skeleton, three, FPS, noise, NO_OCCLUSION, seed=0).observations

    def error_m(positions_m: np.ndarray) -> float:
        return float(np.nanmean(np.linalg.norm(positions_m - truth_m, axis=-1)))

    each_alone_m = error_m(fgpose.refine(observations, three).positions_m)
    assert error_m(fgpose.smooth(observations, three).positions_m) < each_alone_m
