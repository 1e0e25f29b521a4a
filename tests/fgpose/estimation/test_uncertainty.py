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

# Of one frame, across and along some axes.
FRAME_M2 = np.diag([1.0, 4.0, 2.0]) * 1e-4


USUAL = {0.0: 0.36, 0.15: 0.64}
"""Variances of the components of errors, in that of the graph, by the time over which they are correlated."""


USUAL = {0.0: 0.36, 0.15: 0.64}
"""Variances of the components of errors, in that of the graph, by the time over which they are correlated."""


USUAL = {0.0: 0.36, 0.15: 0.64}
"""Variances of the components of errors, in that of the graph, by the time over which they are correlated."""


def of_mean_m2(n_frames: int, step_s: float, variances: dict[float, float] | None = None) -> np.ndarray:
    """Covariance of the mean of so many equal frames; in the graph it is that of a frame by their number."""
    in_graph_m2, variances = FRAME_M2 / n_frames, variances or USUAL
    components = np.array([list(variances.values())]), tuple(variances)
    scaled_m2 = with_correlated_errors(in_graph_m2[None], np.linalg.inv(FRAME_M2)[None], step_s, *components)[0]
    factor = np.trace(scaled_m2) / np.trace(in_graph_m2)
    np.testing.assert_allclose(scaled_m2, factor * in_graph_m2, rtol=1e-10, atol=1e-18)  # the ellipsoid's shape
    return scaled_m2


@pytest.mark.parametrize(("n_frames", "step_s"), [(1, 0.02), (5, 10.0), (50, 10.0), (50, np.inf)])
def test_one_frame_and_frames_far_apart_are_as_in_the_graph(n_frames: int, step_s: float) -> None:
    np.testing.assert_allclose(of_mean_m2(n_frames, step_s), FRAME_M2 / n_frames, rtol=1e-10)


@pytest.mark.parametrize("step_s", [1e-5, 1e-9, 1e-14])
def test_a_constant_error_is_not_averaged_out(step_s: float) -> None:
    """Ten times as many frames of one moment tell hardly more; were they independent, it would be a tenth."""
    few_m2, many_m2 = of_mean_m2(50, step_s), of_mean_m2(500, step_s)
    assert 0.9 * np.trace(few_m2) < np.trace(many_m2) < np.trace(few_m2)  # what is not correlated is averaged out


@pytest.mark.parametrize(
    "variances", [USUAL, {0.0: 0.2, 0.4: 0.3, np.inf: 0.5}, {0.0: 1.0}], ids=["usual", "constant", "white"]
)
@pytest.mark.parametrize("n_frames", [10, 50, 500])
def test_the_covariance_is_that_of_the_mean_of_such_errors(variances: dict[float, float], n_frames: int) -> None:
    """The mean of all elements of their covariance matrix; half of the graph's information is of detections."""
    apart_s = 0.01 * np.abs(np.arange(n_frames)[:, None] - np.arange(n_frames))
    correlation = sum(v * (np.exp(-apart_s / time_s) if time_s else apart_s == 0) for time_s, v in variances.items())
    # Sums are replaced by integrals: half a step of 0.01 s on both ends of a correlation of 0.15 s are 7 %.
    half_m2 = of_mean_m2(2 * n_frames, 0.01, variances)
    np.testing.assert_allclose(2 * half_m2, np.mean(correlation) * FRAME_M2, rtol=0.07, atol=1e-18)


def test_errors_smaller_than_the_graph_believes_leave_what_bones_and_motion_do() -> None:
    """Four tenths of the variance of the graph, as simulated errors say; a tenth of the rest is of detections."""
    found = np.trace(of_mean_m2(100, 0.01, {0.0: 0.1})) / np.trace(FRAME_M2 / 100)
    assert found == pytest.approx(0.4 + 0.1 * 0.6)


def test_what_is_known_depends_on_the_time_and_not_on_the_rate() -> None:
    """What is not correlated is a twentieth here; sums are replaced by integrals."""
    np.testing.assert_allclose(of_mean_m2(100, 0.01), of_mean_m2(50, 0.02), rtol=0.05, atol=1e-18)
    # in 10 and 20 s there are many times the correlation, and twice as many
    np.testing.assert_allclose(of_mean_m2(1000, 0.02), of_mean_m2(500, 0.02) / 2, rtol=0.05, atol=1e-18)


def test_a_covariance_that_is_singular_to_rounding_becomes_positive() -> None:
    """That of a point next to a camera: micrometres in two directions and a metre in the third (seen in a soak)."""
    R = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    singular_m2 = (R * np.array([-1e-16, 4e-10, 2.0])) @ R.T
    scaled_m2 = with_correlated_errors(
        singular_m2[None], np.eye(3)[None], 0.02, np.array([list(USUAL.values())]), tuple(USUAL)
    )[0]
    # 1e-12 of the total variance is far above the rounding errors of the eigenvalues, 1e-15.
    assert np.linalg.eigvalsh(scaled_m2).min() > 1e-12
    # Nothing else changes: the largest variance is scaled by at least 1 and by at most a constant error's factor.
    assert 2.0 <= np.linalg.eigvalsh(scaled_m2).max() < np.inf


def test_batch_covariances_widen_as_trust_vanishes() -> None:
    trust = np.linspace(0.0, 4.0, 81)
    factor = distrust_factor(trust)
    usual, steps = factor[-1], np.diff(factor)
    assert (factor[trust >= 2.0] == usual).all(), "two views that fit are enough"
    assert (steps[trust[1:] < 1.0] < 0).all()
    assert np.abs(steps).max() < 0.1 * usual, "no jump while a detection is distrusted little by little"
    assert factor[0] > 1.5 * usual


def test_online_covariances_widen_with_the_share_that_does_not_fit() -> None:
    weight = np.array([0.5, 2.0, 4.0])
    usual = distrust_factor_online(weight, weight)
    np.testing.assert_array_equal(usual, usual[0])  # few cameras alone do not widen it
    assert distrust_factor_online(np.array([3.0]), np.array([4.0])) == usual[0], "three views that fit are enough"
    share = np.linspace(0.0, 1.0, 11)
    factor = distrust_factor_online(2.0 * share, np.full(11, 2.0))
    assert (np.diff(factor) < 0).all()
    # Hallucinated detections keep their weight: the pose is off by more than the graph says.
    assert factor[0] > 4 * factor[-1]
    assert distrust_factor_online(np.zeros(1), np.zeros(1)) == pytest.approx(factor[0]), "nothing seen is not trusted"


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
    points is what scenes differ by. And the ellipsoids are some per cent too large where motion is smoother than the
    model."""
    filmed: Scene = request.getfixturevalue(scene)
    found = covered(filmed.observations, rig, filmed.truth_m)
    assert 42 < found[50] < 62
    assert found[90] == pytest.approx(90, abs=8)
    assert found[99] > 95


@pytest.mark.slow
def test_the_covariance_of_single_frames_covers_the_error(walking_scene: Scene, rig: fgpose.CameraRig) -> None:
    """Nothing is averaged over time, so correlation has no effect. 170 joints whose errors are independent know a share
    of a half to 4 points."""
    singles = [slice(frame, frame + 1) for frame in range(0, 60, 6)]
    found = [covered(walking_scene.observations.frames(f), rig, walking_scene.truth_m[f]) for f in singles]
    # Wider at the middle: variances are shrunk, and inflated for how few frames tell them.
    assert np.mean([percent[50] for percent in found]) == pytest.approx(50, abs=10)
    assert np.mean([percent[90] for percent in found]) == pytest.approx(90, abs=8)


@pytest.mark.slow
def test_online_covariances_cover_the_error_of_hallucinated_joints(mocap_scene: Scene) -> None:
    """Joints that half of the views or more hallucinate, 139 in two seconds. 84, 99 and 100 % were measured; 37, 72 and
    88 % if covariances are not widened for what does not fit."""
    estimator = fgpose.Estimator(mocap_scene.rig, mocap_scene.observations.skeleton)
    squared = []
    for frame in mocap_scene.observations.frames(slice(0, 100)):
        estimate = estimator.update(frame)
        assert estimate.covariance_m2 is not None
        hallucinated = mocap_scene.occluded[estimate.frame].sum(axis=0) >= 2
        error_m = (estimate.positions_m - mocap_scene.truth_m[estimate.frame])[hallucinated]
        covariance_m2 = estimate.covariance_m2[hallucinated]
        squared += np.einsum("ji,jik,jk->j", error_m, np.linalg.inv(covariance_m2), error_m).tolist()
    found = {percent: 100 * np.mean(np.array(squared) < chi2.ppf(percent / 100, 3)) for percent in (50, 90, 99)}
    assert 50 < found[50] < 90
    assert found[90] > 85
    assert found[99] > 95


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
