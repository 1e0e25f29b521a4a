"""Expected joints: the prediction is that of the stochastic model, the update that of Kalman."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rooms import body_m
from scipy.linalg import expm

from fgpose.association.pose_filter import Expected, PoseFilters
from fgpose.geometry.camera import CameraRig
from fgpose.skeleton import Skeleton
from fgpose_benchmarks.synthetic import ring_rig

SIGMA_M = 0.04
# The model of the module's docstring, in numbers of its own: the swing forgets within 0.3 s and has 1 m/s at rest; the
# velocity of the body is a random walk of 2 m/s2, correlated over 0.3 s.
SWING_S, SWING_MPS, BODY_DENSITY = 0.3, 1.0, 2.0**2 * 0.3


def van_loan(step_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Transition and process noise of position, velocity of the body and velocity of the swing (Van Loan 1978)."""
    F = np.array([[0.0, 1.0, 1.0], [0.0, 0.0, 0.0], [0.0, 0.0, -1.0 / SWING_S]])
    spectral = np.diag([0.0, BODY_DENSITY, 2 * SWING_MPS**2 / SWING_S])
    exponential = expm(np.block([[-F, spectral], [np.zeros((3, 3)), F.T]]) * step_s)
    transition = exponential[3:, 3:].T
    return transition, transition @ exponential[:3, 3:]


def random_filters(n_people: int, n_joints: int, seed: int, velocity_sigma_mps: float = 0.5) -> PoseFilters:
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((n_people, n_joints, 6, 6))
    scale = np.diag([0.05] * 3 + [velocity_sigma_mps] * 3)
    covariance = scale @ (root @ root.swapaxes(-1, -2) / 6 + 0.2 * np.eye(6)) @ scale
    mean = np.concatenate(
        [
            rng.uniform(-0.5, 0.5, (n_people, n_joints, 3)) + np.array([0.0, 0.0, 1.0]),
            rng.normal(size=(n_people, n_joints, 3)),
        ],
        axis=-1,
    )
    return PoseFilters(np.zeros(n_people), mean, covariance)


@pytest.fixture(scope="module")
def person(skeleton: Skeleton) -> PoseFilters:
    filters = random_filters(1, skeleton.n_joints, 0)
    mean = filters.mean.copy()
    mean[0, :, :3] = body_m(skeleton)
    return replace(filters, mean=mean)


@pytest.mark.parametrize("step_s", [1 / 60, 1 / 3, 2.0])
def test_the_mean_moves_as_the_model_says(step_s: float) -> None:
    filters = random_filters(2, 5, 1)
    weight = 1 / np.trace(filters.covariance[..., 3:, 3:], axis1=-2, axis2=-1)
    body_mps = np.stack(
        [np.average(mean[:, 3:], axis=0, weights=w) for mean, w in zip(filters.mean, weight, strict=True)]
    )
    transition, _ = van_loan(step_s)
    body_mps = np.broadcast_to(body_mps[:, None], filters.positions_m.shape)
    state = np.stack([filters.positions_m, body_mps, filters.mean[..., 3:] - body_mps])
    position_m, body_mps, swing_mps = np.einsum("ab,bkjx->akjx", transition, state)
    expected = np.concatenate([position_m, body_mps + swing_mps], axis=-1)
    np.testing.assert_allclose(filters.predicted(step_s).mean, expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("step_s", [1 / 60, 1 / 3, 2.0])
def test_the_process_noise_is_that_of_the_model(step_s: float) -> None:
    """The swing of what is known forgets; the noise is that of position and whole velocity."""
    # All joints as well known as each other: none is drawn in to the reach of the body.
    known = np.diag([0.01**2] * 3 + [0.3**2] * 3)
    filters = PoseFilters(np.zeros(1), np.zeros((1, 4, 6)), np.tile(known, (1, 4, 1, 1)))
    transition, noise = van_loan(step_s)
    whole = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 1.0]])
    of_swing = (whole @ transition)[:, [0, 2]]
    one_axis = of_swing @ np.diag([0.01**2, 0.3**2]) @ of_swing.T + whole @ noise @ whole.T
    expected = np.kron(one_axis, np.eye(3))
    predicted = filters.predicted(step_s).covariance
    np.testing.assert_allclose(predicted, np.broadcast_to(expected, predicted.shape), rtol=1e-8, atol=1e-15)


def test_the_model_itself_moves_like_its_noise() -> None:
    """The numbers of van_loan are those of paths that are drawn step by step: 20,000 paths know a variance to 1 %."""
    rng = np.random.default_rng(0)
    n, dt, end_s = 20_000, 1e-3, 0.3
    position, body, swing = np.zeros((3, n))
    for _ in range(int(end_s / dt)):
        position = position + dt * (body + swing)
        body = body + np.sqrt(BODY_DENSITY * dt) * rng.standard_normal(n)
        swing = swing * (1 - dt / SWING_S) + SWING_MPS * np.sqrt(2 * dt / SWING_S) * rng.standard_normal(n)
    still = PoseFilters(np.zeros(1), np.zeros((1, 1, 6)), np.tile(1e-12 * np.eye(6), (1, 1, 1, 1)))
    noise = still.predicted(end_s).covariance[0, 0][np.ix_([0, 3], [0, 3])]
    # Four standard deviations, and 1 % of the steps of a millisecond.
    np.testing.assert_allclose(np.cov(position, body + swing), noise, rtol=0.05)


def test_what_is_at_a_later_time_already_stays(person: PoseFilters) -> None:
    stays = person.predicted(-1.0)
    np.testing.assert_array_equal(stays.time_s, person.time_s)
    np.testing.assert_allclose(stays.mean, person.mean, rtol=1e-14)
    # The joints here are all within the reach.
    np.testing.assert_allclose(stays.covariance, person.covariance)


def test_a_joint_that_is_not_seen_goes_on_with_the_body(skeleton: Skeleton) -> None:
    mean = np.zeros((1, skeleton.n_joints, 6))
    mean[0, :, :3] = body_m(skeleton)
    mean[0, :, 3] = 1.0
    mean[0, 4, 3:] = (0.0, 2.0, 0.0)
    covariance = np.tile(np.diag([1e-4] * 3 + [1e-2] * 3), (1, skeleton.n_joints, 1, 1))
    covariance[0, 4] *= 1e4
    moved_m = PoseFilters(np.zeros(1), mean, covariance).predicted(3.0).mean[0, 4] - mean[0, 4]
    # 1 m/s for 3 s, less the 0.3 m that the swing of -1 m/s takes; sideways the 0.6 m of the swing of 2 m/s.
    np.testing.assert_allclose(moved_m[:3], [2.7, 0.6, 0.0], atol=1e-3)
    np.testing.assert_allclose(moved_m[3:], [1.0, -2.0, 0.0], atol=1e-3)


def test_no_joint_is_farther_from_the_body_than_the_body_reaches(skeleton: Skeleton) -> None:
    covariance = np.tile(np.diag([1e-4] * 3 + [1e-2] * 3), (1, skeleton.n_joints, 1, 1))
    covariance[0, 4, :3, :3] = 100.0 * np.eye(3)
    mean = np.zeros((1, skeleton.n_joints, 6))
    predicted = PoseFilters(np.zeros(1), mean, covariance).predicted(0.01).covariance
    # 0.4 m, and what the others do not know.
    assert np.sqrt(predicted[0, 4, 0, 0]) == pytest.approx(0.4, abs=0.01)
    np.testing.assert_allclose(predicted[0, 4, :3, :3], predicted[0, 4, 0, 0] * np.eye(3), atol=1e-12)


def sequential(
    filters: PoseFilters, residual_px: np.ndarray, expected: Expected, weight: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance, one camera after another with the gain of Kalman, on the linearised model."""
    mean, covariance = filters.mean.copy(), filters.covariance.copy()
    for c, k, j in np.argwhere(np.isfinite(residual_px).all(axis=-1) & (weight > 0)).tolist():
        ago_s = expected.ago_s[c, k, 0]
        H = expected.jacobian[c, k, j] @ np.hstack([np.eye(3), ago_s * np.eye(3)])
        R = expected.sigma_px[c, k, j] ** 2 / weight[c, k, j] * np.eye(2)
        P = covariance[k, j]
        gain = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
        change = mean[k, j] - filters.mean[k, j]
        mean[k, j] = mean[k, j] + gain @ (residual_px[c, k, j] - H @ change)
        covariance[k, j] = (np.eye(6) - gain @ H) @ P
    return mean, covariance


@pytest.mark.parametrize("times_s", [(0.0, 0.0, 0.0, 0.0), (0.0, -0.01, -0.03, -0.2)])
def test_the_update_is_that_of_kalman(times_s: tuple[float, ...], rig: CameraRig, person: PoseFilters) -> None:
    """Also of images older than the filter: they measure where the joint was, which tells of its velocity."""
    people = PoseFilters.stacked([person, replace(person, mean=person.mean + 0.1)])
    rng = np.random.default_rng(2)
    expected = people.seen_by(rig, np.array(times_s))
    residual_px = rng.normal(scale=10.0, size=expected.pixels.shape)
    residual_px[1, 0, 3] = residual_px[:, 1, 5] = np.nan
    weight = rng.uniform(0.1, 1.0, residual_px.shape[:-1])
    weight[2, :, 7] = 0.0
    updated = people.updated(residual_px, expected, weight)
    mean, covariance = sequential(people, residual_px, expected, weight)
    # Two ways to invert matrices whose condition is about 1e4.
    np.testing.assert_allclose(updated.mean, mean, atol=1e-9)
    np.testing.assert_allclose(updated.covariance, covariance, atol=1e-10)
    np.testing.assert_allclose(updated.covariance[1, 5], people.covariance[1, 5], rtol=1e-8)


def test_the_expected_detection_is_where_the_joint_was(rig: CameraRig, person: PoseFilters) -> None:
    times_s = np.array([0.0, -0.01, -0.1, 0.02])
    expected = person.seen_by(rig, times_s)
    for c, (camera, time_s) in enumerate(zip(rig.cameras, times_s.tolist(), strict=True)):
        was_m = person.positions_m[0] + time_s * person.mean[0, :, 3:]
        np.testing.assert_allclose(expected.pixels[c, 0], camera.project(was_m), atol=1e-9)
        depth_m = camera.to_camera_frame(was_m)[:, 2]
        np.testing.assert_allclose(expected.sigma_px[c, 0], SIGMA_M * 1145.0 / depth_m, rtol=1e-9)
        H = np.hstack([np.eye(3), time_s * np.eye(3)])
        around_px2 = expected.jacobian[c, 0] @ H @ person.covariance[0] @ H.T @ expected.jacobian[c, 0].swapaxes(-1, -2)
        around_px2 = around_px2 + expected.sigma_px[c, 0, :, None, None] ** 2 * np.eye(2)
        np.testing.assert_allclose(expected.covariance_px2[c, 0], around_px2, rtol=1e-9, atol=1e-9)


def test_nothing_is_expected_behind_a_camera_and_nothing_learnt(rig: CameraRig, person: PoseFilters) -> None:
    """The fourth camera stands in front of the person, the others see them."""
    camera = rig.cameras[3]
    behind_m = camera.position_m - 2.0 * camera.world_T_camera[:3, 2]
    people = replace(person, mean=person.mean + np.array([*behind_m, 0.0, 0.0, 0.0]))
    expected = people.seen_by(rig.subset([camera.name]), np.zeros(1))
    assert np.isnan(expected.pixels).all()
    updated = people.updated(np.zeros_like(expected.pixels), expected, np.ones(expected.pixels.shape[:-1]))
    np.testing.assert_allclose(updated.mean, people.mean)
    np.testing.assert_allclose(updated.covariance, people.covariance, rtol=1e-8)


def test_reversed_twice_is_the_same(person: PoseFilters) -> None:
    twice = person.reversed.reversed
    for one, other in zip(
        (twice.time_s, twice.mean, twice.covariance), (person.time_s, person.mean, person.covariance), strict=True
    ):
        np.testing.assert_array_equal(one, other)


def test_reversed_goes_where_it_came_from(person: PoseFilters) -> None:
    ago = person.reversed.seen_by
    np.testing.assert_array_equal(person.reversed.mean[..., 3:], -person.mean[..., 3:])
    rig_times_s = np.array([0.1])
    rig = ring_rig(1)
    np.testing.assert_allclose(ago(rig, rig_times_s).pixels, person.seen_by(rig, -rig_times_s).pixels, atol=1e-9)
    np.testing.assert_allclose(
        ago(rig, rig_times_s).covariance_px2,
        person.seen_by(rig, -rig_times_s).covariance_px2,
        rtol=1e-9,
    )


def test_covariances_stay_covariances_for_a_thousand_steps(rig: CameraRig, person: PoseFilters) -> None:
    """Random steps, cameras, ages and weights; joint 3 is never seen."""
    rng = np.random.default_rng(3)
    people, now_s = person, 0.0
    for step in range(1000):
        now_s += rng.choice([0.0, 0.01, 0.1, 0.5], p=[0.1, 0.5, 0.3, 0.1])
        cameras = rig.subset(rng.permutation(rig.names)[: rng.integers(1, 5)].tolist())
        people = people.predicted(now_s)
        expected = people.seen_by(cameras, now_s - rng.uniform(0, 0.1, cameras.n_cameras))
        true_px = cameras.project(person.positions_m[0])[:, None]
        residual_px = true_px + rng.normal(scale=10.0, size=expected.pixels.shape) - expected.pixels
        residual_px[rng.random(residual_px.shape[:-1]) < 0.3] = np.nan
        residual_px[:, :, 3] = np.nan
        people = people.updated(residual_px, expected, rng.choice([0.0, 1e-6, 1.0], size=residual_px.shape[:-1]))
        if step % 10:
            continue
        variance = np.diagonal(people.covariance, axis1=-2, axis2=-1)
        scale = np.sqrt(variance[..., None] * variance[..., None, :])
        # Rounding of the inverses, as a share of the variances.
        assert np.abs(people.covariance - people.covariance.swapaxes(-1, -2)).max() <= 1e-9 * scale.max()
        assert np.linalg.eigvalsh(people.covariance / scale).min() > 1e-6
    assert np.isfinite(people.mean).all()
    # The last images came after a gap, a third of them without weight: the person is still in the same place.
    assert np.median(np.linalg.norm(people.positions_m - person.positions_m, axis=-1)) < 0.5


def test_several_are_as_each_alone(rig: CameraRig, person: PoseFilters) -> None:
    other = replace(person, time_s=np.array([-0.2]), mean=person.mean + 0.3)
    both = PoseFilters.stacked([person, other])
    assert len(both) == 2
    for together, alone in zip((both[:1], both[1:]), (person, other), strict=True):
        a, b = together.predicted(0.1), alone.predicted(0.1)
        np.testing.assert_allclose(a.mean, b.mean)
        np.testing.assert_allclose(a.covariance, b.covariance)
    # Each looks back from its own time.
    np.testing.assert_allclose(both.seen_by(rig, np.zeros(4)).ago_s[:, :, 0], [[0.0, 0.2]] * 4)
