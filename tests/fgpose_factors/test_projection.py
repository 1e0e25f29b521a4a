from __future__ import annotations

import gtsam
import numpy as np
import pytest

from fgpose_factors import noise_model, projection_factor, projection_residual
from fgpose_factors.testing import numerical_jacobians, numerical_linearization

KEY = gtsam.symbol("x", 0)
K = np.array([[1145.0, 0, 512], [0, 1130.0, 498], [0, 0, 1]])


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def random_camera(rng: np.random.Generator) -> gtsam.PinholeCameraCal3_S2:
    pose = gtsam.Pose3(gtsam.Rot3.Expmap(rng.normal(size=3)), rng.normal(size=3))
    return gtsam.PinholeCameraCal3_S2(pose, gtsam.Cal3_S2(K[0, 0], K[1, 1], 0.0, K[0, 2], K[1, 2]))


def point_in_front(rng: np.random.Generator, camera: gtsam.PinholeCameraCal3_S2) -> np.ndarray:
    return camera.pose().transformFrom(rng.normal(size=3) * (0.5, 0.5, 0.3) + (0, 0, 4))


def camera_T_world(camera: gtsam.PinholeCameraCal3_S2) -> np.ndarray:
    return camera.pose().inverse().matrix()


def at(point_m: np.ndarray) -> gtsam.Values:
    values = gtsam.Values()
    values.insert(KEY, point_m)
    return values


def test_zero_at_the_truth(rng):
    for _ in range(10):
        camera = random_camera(rng)
        point_m = point_in_front(rng, camera)
        residual, _ = projection_residual(point_m, camera_T_world(camera), K, camera.project(point_m))
        np.testing.assert_allclose(residual, 0.0, atol=1e-9)  # rounding of 1000 px
        factor = projection_factor(KEY, camera.project(point_m), noise_model(2, 3.0), camera)
        np.testing.assert_allclose(factor.unwhitenedError(at(point_m)), 0.0, atol=1e-9)


def test_a_measurement_that_is_off_by_3_px_leaves_minus_3_px_and_one_sigma(rng):
    camera = random_camera(rng)
    point_m = point_in_front(rng, camera)
    measured_px = camera.project(point_m) + np.array([3.0, 0.0])
    factor = projection_factor(KEY, measured_px, noise_model(2, 3.0), camera)
    np.testing.assert_allclose(factor.unwhitenedError(at(point_m)), [-3.0, 0.0], atol=1e-9)
    assert factor.error(at(point_m)) == pytest.approx(0.5)


def test_one_centimetre_sideways_at_4_m_is_focal_length_over_400(rng):
    point_m = np.array([0.01, 0.0, 4.0])
    residual, _ = projection_residual(point_m, np.eye(4), K, K[:2, 2])
    np.testing.assert_allclose(residual, [1145.0 / 400, 0.0], atol=1e-12)


def test_jacobian_equals_central_differences(rng):
    for _ in range(20):
        camera = random_camera(rng)
        point_m = point_in_front(rng, camera)
        pose, measured_px = camera_T_world(camera), camera.project(point_m) + rng.normal(size=2)
        _, (jacobian,) = projection_residual(point_m, pose, K, measured_px)
        (expected,) = numerical_jacobians(
            lambda p, pose=pose, z=measured_px: projection_residual(p, pose, K, z)[0], [point_m]
        )
        # 1e-6 m steps: rounding of 1000 px / 1e-6 m is 1e-4 px/m, on values of 300 px/m
        np.testing.assert_allclose(jacobian, expected, atol=2e-4)
        factor = projection_factor(KEY, measured_px, noise_model(2, 3.0), camera)
        A, b = factor.linearize(at(point_m)).jacobian()
        numerical_A, numerical_b = numerical_linearization(factor, at(point_m))
        np.testing.assert_allclose(A, numerical_A, atol=1e-4)
        np.testing.assert_allclose(b, numerical_b, atol=1e-9)


def test_agrees_with_gtsams_projection_factor_of_an_unknown_pose(rng):
    """Our pure residual, the native factor with a known camera, and the textbook factor on a pose and a point."""
    pose_key, calibration = gtsam.symbol("p", 0), gtsam.Cal3_S2(K[0, 0], K[1, 1], 0.0, K[0, 2], K[1, 2])
    for _ in range(10):
        camera = random_camera(rng)
        point_m = point_in_front(rng, camera)
        measured_px = camera.project(point_m) + 5 * rng.normal(size=2)
        residual, (jacobian,) = projection_residual(point_m, camera_T_world(camera), K, measured_px)
        noise = noise_model(2, 1.0)
        ours = projection_factor(KEY, measured_px, noise, camera)
        textbook = gtsam.GenericProjectionFactorCal3_S2(measured_px, noise, pose_key, KEY, calibration)
        values = at(point_m)
        np.testing.assert_allclose(ours.unwhitenedError(values), residual, atol=1e-9)
        np.testing.assert_allclose(ours.linearize(values).jacobian()[0], jacobian, atol=1e-9)
        values.insert(pose_key, camera.pose())
        np.testing.assert_allclose(textbook.unwhitenedError(values), residual, atol=1e-9)
        # keys come in the order of the factor: six columns of the pose, then three of the point
        np.testing.assert_allclose(textbook.linearize(values).jacobian()[0][:, 6:], jacobian, atol=1e-9)


def test_many_points_at_once_are_the_points_one_by_one(rng):
    camera = random_camera(rng)
    points_m = np.stack([point_in_front(rng, camera) for _ in range(6)]).reshape(2, 3, 3)
    measured_px = rng.normal(size=(2, 3, 2)) + K[:2, 2]
    residuals, (jacobians,) = projection_residual(points_m, camera_T_world(camera), K, measured_px)
    assert residuals.shape == (2, 3, 2)
    assert jacobians.shape == (2, 3, 2, 3)
    for i, j in np.ndindex(2, 3):
        residual, (jacobian,) = projection_residual(points_m[i, j], camera_T_world(camera), K, measured_px[i, j])
        np.testing.assert_allclose(residuals[i, j], residual, rtol=1e-12, atol=1e-9)
        np.testing.assert_allclose(jacobians[i, j], jacobian, rtol=1e-12, atol=1e-9)


def test_does_not_depend_on_the_frame_of_the_world(rng):
    camera = random_camera(rng)
    point_m, measured_px = point_in_front(rng, camera), np.array([500.0, 400.0])
    motion = gtsam.Pose3(gtsam.Rot3.Expmap(rng.normal(size=3)), rng.normal(size=3))
    moved = gtsam.PinholeCameraCal3_S2(motion.compose(camera.pose()), camera.calibration())
    before, _ = projection_residual(point_m, camera_T_world(camera), K, measured_px)
    after, _ = projection_residual(motion.transformFrom(point_m), camera_T_world(moved), K, measured_px)
    np.testing.assert_allclose(after, before, atol=1e-9)


def test_a_point_behind_the_camera_neither_pulls_nor_prints(capfd):
    camera = gtsam.PinholeCameraCal3_S2(gtsam.Pose3(), gtsam.Cal3_S2(K[0, 0], K[1, 1], 0.0, K[0, 2], K[1, 2]))
    factor = projection_factor(KEY, np.array([600.0, 300.0]), noise_model(2, 1.0), camera)
    for point_m in (np.array([0.0, 0.1, -1.0]), np.array([2.0, 0.0, -3.0])):
        np.testing.assert_array_equal(factor.unwhitenedError(at(point_m)), 2 * K[0, 0])
        A, _ = factor.linearize(at(point_m)).jacobian()
        np.testing.assert_array_equal(A, 0.0)
        residual, (jacobian,) = projection_residual(point_m, np.eye(4), K, np.array([600.0, 300.0]))
        assert np.isnan(residual).all()
        assert np.isnan(jacobian).all()
    printed = capfd.readouterr()
    assert printed.out == ""
    assert printed.err == ""


def test_nothing_is_seen_in_the_plane_of_the_camera():
    """A Jacobian of 1e12 px/m would leave no digit for anything else in the system."""
    for depth_m, seen in ((1e-9, False), (0.009, False), (0.011, True)):
        residual, (jacobian,) = projection_residual(np.array([0.0, 0.0, depth_m]), np.eye(4), K, np.zeros(2))
        assert np.isfinite(residual).all() == np.isfinite(jacobian).all() == seen
