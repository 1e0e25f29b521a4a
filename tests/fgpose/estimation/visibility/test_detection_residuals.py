"""What each detection says: against the pose without its camera, and for a visible joint or a hallucinated one."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from jaxtyping import Float

import fgpose
from fgpose.config import Config
from fgpose.estimation.evidence.evidence import Evidence
from fgpose.estimation.evidence.gather import gather
from fgpose.estimation.visibility import detection_residuals as module
from fgpose.estimation.visibility.agreement import Agreement
from fgpose.estimation.visibility.detection_residuals import _PREDICTED_M, DetectionResiduals
from fgpose.estimation.visibility.spread import graph_sigma_px
from fgpose.estimation.visibility.visibility_chain import Chain
from fgpose.geometry.camera import CameraRig
from fgpose.skeleton import Skeleton
from fgpose_benchmarks.synthetic import NO_NOISE, NO_OCCLUSION, DetectionNoise, Occlusion, Scene, simulate, walking
from fgpose_factors import projection_residual
from tests.wrong_rigs import turned

FPS = 30.0
CONFIG = Config()
PRIOR_M = CONFIG.visibility.sigma_m
# What a detection is worth when errors are correlated over 0.15 s, at 30 frames a second.
INDEPENDENT = 1 / 9
SPREAD_M = np.array([0.01, 0.018, 0.03, 0.02])
PREDICTED_M = _PREDICTED_M[CONFIG.motion.model]


def exact(rig: CameraRig, skeleton: Skeleton, n_frames: int = 1) -> tuple[np.ndarray, Evidence]:
    """Positions, and detections without errors whose weight tells nothing."""
    truth_m = walking(n_frames, FPS, skeleton)
    evidence = gather(simulate(truth_m, skeleton, rig, FPS, NO_NOISE, NO_OCCLUSION, seed=0).observations, rig, CONFIG)
    return truth_m, replace(evidence, weights=np.full(evidence.weights.shape, 0.5))


def residuals_of(positions_m: np.ndarray, evidence: Evidence, rig: CameraRig) -> DetectionResiduals:
    return DetectionResiduals.of(positions_m, evidence, rig, CONFIG)


@dataclass(frozen=True, eq=False)
class LinearCase:
    """Detections with errors so small that projections are linear and the robust kernel does nothing."""

    truth_m: Float[np.ndarray, "frame joint 3"]
    predicted_m: Float[np.ndarray, "frame joint 3"]
    """What bones and motion say, relative to the truth."""
    error_px: Float[np.ndarray, "frame camera joint 2"]
    jacobian: Float[np.ndarray, "frame camera joint 2 3"]
    information: Float[np.ndarray, "frame camera joint"]
    evidence: Evidence

    def solved_m(self, frame: int, joint: int, left_out: int | None = None) -> np.ndarray:
        """Least squares, relative to the truth."""
        rows, values = [np.eye(3) / PREDICTED_M], [self.predicted_m[frame, joint] / PREDICTED_M]
        for camera in range(4):
            if camera != left_out and np.isfinite(self.error_px[frame, camera, joint]).all():
                root = np.sqrt(self.information[frame, camera, joint])
                rows.append(root * self.jacobian[frame, camera, joint])
                values.append(root * self.error_px[frame, camera, joint])
        return np.linalg.lstsq(np.concatenate(rows), np.concatenate(values))[0]

    def covariance_m2(self, frame: int, joint: int, left_out: int | None = None) -> np.ndarray:
        information = np.eye(3) / PREDICTED_M**2
        for camera in range(4):
            if camera != left_out and np.isfinite(self.error_px[frame, camera, joint]).all():
                J = self.jacobian[frame, camera, joint]
                information += self.information[frame, camera, joint] * J.T @ J
        return np.linalg.inv(information)


@pytest.fixture
def linear(rig: CameraRig, skeleton: Skeleton) -> LinearCase:
    rng = np.random.default_rng(0)
    truth_m, evidence = exact(rig, skeleton, n_frames=2)
    error_px = 1e-4 * rng.normal(size=evidence.undistorted_px.shape)
    error_px[0, 1, 3] = error_px[1, :2, 5] = error_px[1, :, 7] = np.nan
    weights = rng.uniform(0.1, 1.0, evidence.weights.shape)
    px = evidence.undistorted_px
    jacobian = np.stack(
        [projection_residual(truth_m, c.camera_T_world, c.K, px[:, n])[1][0] for n, c in enumerate(rig.cameras)], axis=1
    )
    px_per_m = np.sqrt(np.sum(jacobian**2, axis=(-1, -2)) / 2)
    return LinearCase(
        truth_m=truth_m,
        predicted_m=4e-7 * rng.normal(size=truth_m.shape),
        error_px=error_px,
        jacobian=jacobian,
        information=weights / (SPREAD_M[:, None] * px_per_m) ** 2,
        evidence=replace(
            evidence, undistorted_px=px + error_px, weights=weights, sigma_px=SPREAD_M[:, None] * px_per_m
        ),
    )


def solved(case: LinearCase, rig: CameraRig) -> DetectionResiduals:
    relative_m = np.array([[case.solved_m(t, j) for j in range(17)] for t in range(2)])
    return residuals_of(case.truth_m + relative_m, case.evidence, rig)


def test_the_predictive_residual_is_that_without_the_camera(linear: LinearCase, rig: CameraRig) -> None:
    found = solved(linear, rig)
    for t, c, j in np.argwhere(np.isfinite(linear.error_px).all(axis=-1)).tolist():
        J = linear.jacobian[t, c, j]
        expected_px = J @ linear.solved_m(t, j, left_out=c) - linear.error_px[t, c, j]
        # Pixels near 1,000 are known to 1e-13, and a step of 1e-6 m at 4 m is linear to as little: of 1e-4 px, 1e-6.
        np.testing.assert_allclose(found.predictive_px[t, c, j], expected_px, atol=1e-9)
        expected_px2 = J @ linear.covariance_m2(t, j, left_out=c) @ J.T
        np.testing.assert_allclose(found.predictive_px2[t, c, j], expected_px2, atol=1e-6 * np.trace(expected_px2))


def test_the_redundancies_of_a_joint_are_what_its_position_leaves(linear: LinearCase, rig: CameraRig) -> None:
    """Two numbers for each camera, less the three of the position as far as the detections determine them."""
    found = solved(linear, rig)
    for t, j in np.ndindex(2, 17):
        n_seen = int(found.seen[t, :, j].sum())
        determined = 3 - np.trace(linear.covariance_m2(t, j)) / PREDICTED_M**2
        left = 2 * found.redundancy[t, found.seen[t, :, j], j].sum()
        assert left == pytest.approx(2 * n_seen - determined, abs=1e-6)


def smoothed(scene: Scene, rig: CameraRig) -> DetectionResiduals:
    """Against the joints that the smoother finds in the detections, errors in all frames taken for noise."""
    positions_m = fgpose.smooth(scene.observations, rig, Config(visibility={"bias": "none"})).positions_m
    return residuals_of(positions_m, gather(scene.observations, rig, CONFIG), rig)


def noisy(rig: CameraRig, skeleton: Skeleton, sigma_px: float, n_frames: int = 150) -> Scene:
    noise = DetectionNoise(sigma_px=sigma_px, correlated_px=0.0, outlier_share=0.0)
    return simulate(walking(n_frames, FPS, skeleton), skeleton, rig, FPS, noise, NO_OCCLUSION, seed=0)


@pytest.mark.parametrize("sigma_px", [2.0, pytest.param(5.0, marks=pytest.mark.slow), 12.0])
def test_the_spread_is_that_of_the_recording(sigma_px: float, rig: CameraRig, skeleton: Skeleton) -> None:
    residuals = smoothed(noisy(rig, skeleton, sigma_px), rig)
    true_m = np.sqrt(np.mean((sigma_px / residuals.px_per_m) ** 2, axis=(0, 2)))
    # 2,550 lengths in each camera: 0.72 / sqrt(2550) = 1.4 %. 30 measurements of prior against 1,000: 2.8 % at 12 px,
    # 2.6 times the prior. The redundancy is that of one frame, with a rough prior: 2 to 4 % too large at 2 px.
    np.testing.assert_allclose(residuals.spread_m(PRIOR_M, INDEPENDENT), true_m, rtol=0.06)


@pytest.mark.slow
def test_a_camera_that_was_moved_has_a_larger_spread(rig: CameraRig, skeleton: Skeleton) -> None:
    scene = noisy(rig, skeleton, 3.0)
    usual_m = smoothed(scene, rig).spread_m(PRIOR_M, INDEPENDENT)
    moved_m = smoothed(scene, turned(rig, 2, 1.0)).spread_m(PRIOR_M, INDEPENDENT)
    # 1 degree is 20 px, 8 cm; measured are 12 mm before and 51 mm after. The others pay at most 12 %.
    assert moved_m[2] > 3 * usual_m[2]
    np.testing.assert_allclose(np.delete(moved_m, 2), np.delete(usual_m, 2), rtol=0.2)


def test_of_two_cameras_none_becomes_exact(rig: CameraRig, skeleton: Skeleton) -> None:
    """A pose follows the camera whose errors are taken for smaller. That this leaves small residuals says nothing."""
    two, truth_m = rig.subset(rig.names[:2]), walking(150, FPS, skeleton)
    noise = DetectionNoise(sigma_px=5.0, correlated_px=0.0, outlier_share=0.0)
    scene = simulate(truth_m, skeleton, two, FPS, noise, Occlusion(n_views=1), seed=0)
    config = Config(motion={"model": "none"}, solver={"covariance": False})
    residual_px = fgpose.smooth(scene.observations, two, config).residual_px
    assert residual_px is not None
    smaller_px, larger_px = np.sort(np.nanmedian(residual_px, axis=(0, 2)))
    # Over five seeds the larger is 1.4 to 2.8 times the smaller; if that counted, 8 to 118 times.
    assert larger_px < 5 * smaller_px


def test_few_detections_leave_the_usual_spread(rig: CameraRig, skeleton: Skeleton) -> None:
    residuals = smoothed(noisy(rig, skeleton, 12.0, n_frames=2), rig)
    spread_m = residuals.spread_m(PRIOR_M, INDEPENDENT)
    # The errors are 2.6 times as large. 2 frames of 68 detections are 12 measurements against 30: 2.6^(12 / 42) = 1.31.
    assert (spread_m > PRIOR_M).all()
    assert (spread_m < 1.4 * PRIOR_M).all()
    nobody = replace(residuals, seen=np.zeros_like(residuals.seen))
    np.testing.assert_array_equal(nobody.spread_m(PRIOR_M, INDEPENDENT), PRIOR_M)
    one_camera = replace(residuals, seen=residuals.seen & (np.arange(4) == 1)[:, None])
    np.testing.assert_array_equal(one_camera.spread_m(PRIOR_M, 1.0), PRIOR_M)  # a joint follows its only detection
    two_cameras = replace(residuals, seen=residuals.seen & (np.arange(4) < 2)[:, None])
    assert (two_cameras.spread_m(PRIOR_M, 1.0)[:2] > 1.5 * PRIOR_M).all()


def odds_of(positions_m: np.ndarray, evidence: Evidence, rig: CameraRig, skeleton: Skeleton) -> np.ndarray:
    spread_m = np.full(rig.n_cameras, PRIOR_M)
    residuals = residuals_of(positions_m, evidence, rig)
    usual = np.full(residuals.seen.shape, Chain(CONFIG.visibility).usual)
    given = residuals, spread_m[None, :, None], spread_m, usual, 0.0, rig, skeleton, CONFIG.visibility
    return Agreement.of(*given).log_odds


def moved(evidence: Evidence, camera: int, joint: int, to_px: np.ndarray) -> Evidence:
    points_px = evidence.undistorted_px.copy()
    points_px[0, camera, joint] = to_px
    return replace(evidence, undistorted_px=points_px)


def test_a_detection_that_fits_speaks_for_visible_and_a_wrong_one_for_hidden(
    rig: CameraRig, skeleton: Skeleton
) -> None:
    positions_m, evidence = exact(rig, skeleton)
    assert odds_of(positions_m, evidence, rig, skeleton).min() > 0
    wrist = skeleton.index("left_wrist")
    odds = []
    for wrong_px in (0.0, 10.0, 30.0, 100.0):
        to_px = evidence.undistorted_px[0, 0, wrist] + np.array([wrong_px, 0.0])
        of_all = odds_of(positions_m, moved(evidence, 0, wrist, to_px), rig, skeleton)
        odds.append(of_all[0, 0, wrist])
        of_all[0, 0, wrist] = np.inf
        assert of_all.min() > 0, "the others fit"
    assert odds[-1] < 0
    assert (np.diff(odds) < 0).all()


def test_a_detection_at_another_joint_speaks_more_for_hidden(rig: CameraRig, skeleton: Skeleton) -> None:
    """Than one equally far from its joint where no joint is; most at the mirrored joint."""
    positions_m, evidence = exact(rig, skeleton)
    joints_px, wrist = evidence.undistorted_px[0, 0], skeleton.index("left_wrist")
    mirrored, other = skeleton.index("right_wrist"), skeleton.index("left_knee")
    odds = {}
    for name, joint in (("mirrored", mirrored), ("other", other)):
        distance_px = np.linalg.norm(joints_px[joint] - joints_px[wrist])
        angle = np.linspace(0, 2 * np.pi, 360, endpoint=False)
        around_px = joints_px[wrist] + distance_px * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        to_joints_px = np.linalg.norm(around_px[:, None] - joints_px, axis=-1).min(axis=1)
        assert to_joints_px.max() > 40, "the spread is 5 px"
        for where, to_px in (("at", joints_px[joint]), ("far", around_px[to_joints_px.argmax()])):
            odds[name, where] = odds_of(positions_m, moved(evidence, 0, wrist, to_px), rig, skeleton)[0, 0, wrist]
    assert odds["mirrored", "at"] < odds["mirrored", "far"] - 1
    assert odds["other", "at"] < odds["other", "far"] - 1
    without_mirror = replace(skeleton, left_right=(), limbs=())
    at_mirrored = moved(evidence, 0, wrist, joints_px[mirrored])
    unmirrored = odds_of(positions_m, at_mirrored, rig, without_mirror)[0, 0, wrist]
    # A share of 0.3 of hidden joints is detected at another joint: of these 1/2 + 1/2 / 16 at the mirrored one instead
    # of 1/16, 8.5 times as many. "Anywhere" adds the same to both.
    assert odds["mirrored", "at"] < unmirrored - 1
    assert odds["mirrored", "at"] > unmirrored - np.log(8.5)


def test_the_weight_before_counts_a_little(rig: CameraRig, skeleton: Skeleton) -> None:
    positions_m, evidence = exact(rig, skeleton)
    usual = odds_of(positions_m, evidence, rig, skeleton)
    for weight, ratio in ((0.8, 4.0), (0.2, 0.25), (1.0, 99.0)):
        weights = evidence.weights.copy()
        weights[0, 1, 4] = weight
        odds = odds_of(positions_m, replace(evidence, weights=weights), rig, skeleton)
        # The pose without the camera does not depend on the weight there.
        np.testing.assert_allclose(odds[0, 1, 4] - usual[0, 1, 4], 0.3 * np.log(ratio), rtol=1e-9)


def test_nothing_is_said_where_nothing_is_seen(rig: CameraRig, skeleton: Skeleton) -> None:
    positions_m, evidence = exact(rig, skeleton)
    positions_m = positions_m.copy()
    positions_m[0, 3] = np.nan  # not estimated
    camera = rig.cameras[2]
    positions_m[0, 5] = camera.position_m - camera.world_T_camera[:3, 2]  # 1 m behind the camera
    positions_m[0, 6] = camera.position_m  # in its centre
    points_px = evidence.undistorted_px.copy()
    points_px[0, 1, 4] = np.nan  # not detected
    evidence = replace(evidence, undistorted_px=points_px)
    nothing = np.zeros((1, 4, 17), dtype=bool)
    nothing[0, :, 3] = nothing[0, 1, 4] = nothing[0, 2, 5:7] = True
    residuals = residuals_of(positions_m, evidence, rig)
    np.testing.assert_array_equal(residuals.seen, ~nothing)
    odds = odds_of(positions_m, evidence, rig, skeleton)
    np.testing.assert_array_equal(odds == 0, nothing)
    of_residuals = {
        name: array
        for name, array in vars(residuals).items()
        if name not in ("positions_m", "undistorted_px", "contradictions")
    }
    for name, array in {
        **of_residuals,
        "odds": odds,
        "sigma": graph_sigma_px(evidence, SPREAD_M, rig.px_per_m(positions_m)),
    }.items():
        assert np.isfinite(array).all(), name
    assert np.isfinite(residuals.spread_m(PRIOR_M, INDEPENDENT)).all()


@pytest.mark.parametrize("frames_at_once", [1, 7])
def test_pairs_of_joints_are_the_same_in_pieces_of_a_window(
    rig: CameraRig, skeleton: Skeleton, monkeypatch: pytest.MonkeyPatch, frames_at_once: int
) -> None:
    """To the last digit: whatever is shown or written of a window follows from them."""
    truth_m = walking(24, FPS, skeleton)
    seen = simulate(truth_m, skeleton, rig, FPS, DetectionNoise(), Occlusion(), seed=1).observations
    residuals = residuals_of(truth_m, gather(seen, rig, CONFIG), rig)

    def densities() -> np.ndarray:
        found = residuals.log_densities(np.full((1, 1, 1), PRIOR_M), rig, skeleton, CONFIG.visibility)
        return np.array([found.visible, found.hidden, found.other])

    whole = densities()
    monkeypatch.setattr(module, "_FRAMES_AT_ONCE", frames_at_once)
    np.testing.assert_array_equal(densities(), whole)
