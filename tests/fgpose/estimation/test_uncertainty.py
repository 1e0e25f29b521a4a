"""Covariances: of errors that are correlated in time, and of joints that no camera sees."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

import fgpose
from fgpose.config import SwingConfig, config_from_dict
from fgpose.estimation.noise import with_correlated_errors
from fgpose.estimation.uncertainty import distrust_factor, distrust_factor_online, with_swing
from fgpose.skeleton import Skeleton
from fgpose.synthetic import Scene

CORRELATED_SHARE = 4.0**2 / 5.0**2
EQUAL_FRAMES = 0.35
"""Frames of equal weight in one unit of information over that of a frame alone."""


def scaled_by(n_frames: float, step_s: float) -> float:
    """Factor on a covariance to which so many frames contribute equally."""
    covariance_m2 = np.diag([1.0, 4.0, 2.0]) * 1e-4
    frame_information = np.linalg.inv(covariance_m2) * EQUAL_FRAMES / n_frames
    scaled_m2 = with_correlated_errors(covariance_m2[None], frame_information[None], step_s)[0]
    factor = float(np.trace(scaled_m2) / np.trace(covariance_m2))
    np.testing.assert_allclose(
        scaled_m2, factor * covariance_m2, rtol=1e-10, atol=1e-18
    )  # the ellipsoid keeps its shape
    return factor


@pytest.mark.parametrize("n_frames", [1.0, 5.0, 50.0])
@pytest.mark.parametrize("step_s", [10.0, np.inf])
def test_errors_of_frames_far_apart_are_independent(n_frames: float, step_s: float) -> None:
    """As the graph takes them to be."""
    assert scaled_by(n_frames, step_s) == pytest.approx(1.0, rel=0.02)


@pytest.mark.parametrize("n_frames", [1.0, 5.0, 50.0])
@pytest.mark.parametrize("step_s", [1e-5, 1e-9, 1e-14])
def test_errors_of_frames_close_together_are_the_same(n_frames: float, step_s: float) -> None:
    """A constant error is not averaged out: with n frames its variance is n times what the graph states."""
    expected = 1 - CORRELATED_SHARE + CORRELATED_SHARE * n_frames
    assert scaled_by(n_frames, step_s) == pytest.approx(expected, rel=0.01)


def test_errors_that_are_correlated_in_time_against_simulated_ones() -> None:
    """The mean of 20 frames 20 ms apart, its variance from 20,000 draws: known to 1 %, 5 % is what the formula claims
    for sums in place of integrals."""
    n_frames, step_s = 20, 0.02
    lag_s = step_s * np.abs(np.subtract.outer(np.arange(n_frames), np.arange(n_frames)))
    of_errors = CORRELATED_SHARE * np.exp(-lag_s / 0.15) + (1 - CORRELATED_SHARE) * np.eye(n_frames)
    errors = np.random.default_rng(0).multivariate_normal(np.zeros(n_frames), of_errors, 20_000)
    variance = errors.mean(axis=1).var() * n_frames
    assert scaled_by(n_frames, step_s) == pytest.approx(variance, rel=0.05)


def test_a_covariance_that_is_singular_to_rounding_becomes_positive() -> None:
    """That of a point next to a camera: micrometres in two directions and a metre in the third (seen in a soak)."""
    R = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    singular_m2 = (R * np.array([-1e-16, 4e-10, 2.0])) @ R.T
    scaled_m2 = with_correlated_errors(singular_m2[None], np.eye(3)[None], 0.02)[0]
    # 1e-12 of the total variance is far above the rounding errors of the eigenvalues, 1e-15.
    assert np.linalg.eigvalsh(scaled_m2).min() > 1e-12
    # Nothing else changes: the largest variance is scaled by at least 1 and by at most a constant error's factor.
    assert 2.0 <= np.linalg.eigvalsh(scaled_m2).max() < np.inf


def test_factor_where_hardly_any_detection_is_trusted() -> None:
    usual = distrust_factor(np.array([4.0]))
    found = distrust_factor(np.array([0.0, 0.75, 1.5, 3.0]))
    np.testing.assert_allclose(found, usual * np.array([2.0, 1.25, 1.0, 1.0]))


def test_online_factor_grows_with_the_share_that_does_not_fit() -> None:
    usual = distrust_factor_online(np.array([4.0]), np.array([4.0]))
    # two cameras alone do not widen the covariance, nor do detections that do not fit where enough others do
    trusted = distrust_factor_online(np.array([2.0, 2.5]), np.array([2.0, 4.0]))
    np.testing.assert_allclose(trusted, usual * np.ones(2))
    grave = distrust_factor_online(np.array([1.0, 0.0]), np.array([2.0, 0.0]))
    np.testing.assert_allclose(grave, usual * np.array([1 + 20 * 0.5**2, 21.0]))


def covered(observations: fgpose.Observations, rig: fgpose.CameraRig, truth_m: np.ndarray) -> dict[int, float]:
    """Per cent of the errors within the ellipsoids of 50, 90 and 99 %."""
    trajectory = fgpose.smooth(observations, rig, config_from_dict({"solver": {"covariance": True}}))
    assert trajectory.covariance_m2 is not None
    error_m = trajectory.positions_m - truth_m
    squared = np.einsum("tji,tjik,tjk->tj", error_m, np.linalg.inv(trajectory.covariance_m2), error_m)
    return {percent: float(100 * np.mean(squared < chi2.ppf(percent / 100, 3))) for percent in (50, 90, 99)}


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["mocap_scene", "walking_scene"])
def test_covariances_cover_the_error(scene: str, request: pytest.FixtureRequest, rig: fgpose.CameraRig) -> None:
    """Occluded and not. One scene of two or three seconds has a few dozen independent errors of 17 joints: eight
    points is what scenes differ by."""
    filmed: Scene = request.getfixturevalue(scene)
    found = covered(filmed.observations, rig, filmed.truth_m)
    assert found[50] == pytest.approx(50, abs=8)
    assert found[90] == pytest.approx(90, abs=8)
    assert found[99] > 95


@pytest.mark.slow
def test_the_covariance_of_single_frames_covers_the_error(walking_scene: Scene, rig: fgpose.CameraRig) -> None:
    """Nothing is averaged over time, so correlation has no effect. On the safe side only: sigma_px is cautious."""
    singles = [slice(frame, frame + 1) for frame in range(0, 60, 6)]
    found = [covered(walking_scene.observations.frames(f), rig, walking_scene.truth_m[f]) for f in singles]
    assert np.mean([percent[50] for percent in found]) > 42
    assert np.mean([percent[90] for percent in found]) > 82


def widened(skeleton: Skeleton, unseen: dict[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """Added covariance and positions of a straight body, some joints unseen for a while."""
    positions_m = np.zeros((1, skeleton.n_joints, 3))
    for start, end in skeleton.bones:
        positions_m[0, end] = positions_m[0, start] + [0.0, 0.0, -0.3]
    unseen_s = np.zeros((1, skeleton.n_joints))
    for name, seconds in unseen.items():
        unseen_s[0, skeleton.index(name)] = seconds
    nothing = np.zeros((1, skeleton.n_joints, 3, 3))
    return with_swing(nothing, positions_m, unseen_s, skeleton, SwingConfig())[0], positions_m[0]


def test_a_seen_joint_keeps_its_covariance(skeleton: Skeleton) -> None:
    added, _ = widened(skeleton, {"right_wrist": 1.0})
    others = np.arange(skeleton.n_joints) != skeleton.index("right_wrist")
    assert not added[others].any()


def test_the_swing_is_across_the_bone(skeleton: Skeleton) -> None:
    """After a long time the end of a 0.3 m bone is off by L a across (two directions) and L a^2 / 2 along it."""
    added, _ = widened(skeleton, {"right_wrist": 1e3})
    angle = SwingConfig().angle_rad
    expected = np.diag([(0.3 * angle) ** 2 / 2, (0.3 * angle) ** 2 / 2, (0.3 * angle**2 / 2) ** 2])
    np.testing.assert_allclose(added[skeleton.index("right_wrist")], expected, rtol=1e-9)


def test_it_grows_with_time_and_along_the_limb(skeleton: Skeleton) -> None:
    elbow, wrist = skeleton.index("right_elbow"), skeleton.index("right_wrist")
    short, _ = widened(skeleton, {"right_wrist": 0.1})
    long, _ = widened(skeleton, {"right_wrist": 1.0})
    both, _ = widened(skeleton, {"right_wrist": 1.0, "right_elbow": 1.0})
    assert np.trace(short[wrist]) < np.trace(long[wrist]) < np.trace(both[wrist])
    np.testing.assert_allclose(both[wrist], long[wrist] + both[elbow])


def test_a_bone_of_length_zero_adds_nothing(skeleton: Skeleton) -> None:
    positions_m = np.zeros((1, skeleton.n_joints, 3))
    unseen_s = np.ones((1, skeleton.n_joints))
    nothing = np.zeros((1, skeleton.n_joints, 3, 3))
    assert not with_swing(nothing, positions_m, unseen_s, skeleton, SwingConfig()).any()
