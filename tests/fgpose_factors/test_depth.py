from __future__ import annotations

import gtsam
import numpy as np
import pytest

from fgpose_factors import depth_factor, depth_information, noise_model, projection_factor
from fgpose_factors.depth import LATERAL_SIGMA_M
from fgpose_factors.testing import numerical_linearization

KEY = gtsam.symbol("x", 0)
POINT_M = np.array([0.5, -0.2, 4.0])
RAY = POINT_M / np.linalg.norm(POINT_M)
SIGMA_M = 0.15


def at(point_m: np.ndarray) -> gtsam.Values:
    values = gtsam.Values()
    values.insert(KEY, point_m)
    return values


def test_residual_is_the_error_along_the_ray_in_sigmas() -> None:
    factor = depth_factor(KEY, POINT_M, RAY, SIGMA_M)
    assert factor.error(at(POINT_M)) == pytest.approx(0.0)
    assert factor.error(at(POINT_M + 0.3 * RAY)) == pytest.approx(0.5 * (0.3 / SIGMA_M) ** 2)
    across = np.cross(RAY, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    assert factor.error(at(POINT_M + 0.3 * across)) == pytest.approx(0.5 * (0.3 / LATERAL_SIGMA_M) ** 2)


def test_jacobian_is_the_numerical_one() -> None:
    factor = depth_factor(KEY, POINT_M, RAY, SIGMA_M)
    values = at(POINT_M + np.array([0.1, -0.05, 0.2]))
    A, b = factor.linearize(values).jacobian()
    expected_A, expected_b = numerical_linearization(factor, values)
    # the residual is linear: central differences are exact but for rounding, 1e-16 / 1e-6 of 1 / SIGMA_M
    np.testing.assert_allclose(A, expected_A, atol=1e-8)
    np.testing.assert_allclose(b, expected_b, atol=1e-12)


@pytest.mark.parametrize("scale", [1.0, 1e-9, 1e9])
def test_information_of_many_rays_is_along_the_ray(scale: float) -> None:
    """However well or badly a depth is known: as the inverse of a covariance it was singular."""
    rng = np.random.default_rng(0)
    rays = rng.normal(size=(4, 5, 3))
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    sigmas_m = scale * rng.uniform(0.05, 0.3, size=(4, 5))
    across = np.cross(rays, [0.0, 0.0, 1.0])
    information = depth_information(rays, sigmas_m)
    along = np.einsum("tri,trij,trj->tr", rays, information, rays)
    # Across it a digit in 1e16 of what is along is rounding.
    rounding = 1e-15 / sigmas_m.min() ** 2
    np.testing.assert_allclose(along, sigmas_m**-2, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(
        (information @ across[..., None])[..., 0], across / LATERAL_SIGMA_M**2, rtol=1e-12, atol=max(rounding, 1e-14)
    )


def test_one_pixel_and_one_depth_determine_a_point() -> None:
    camera = gtsam.PinholeCameraCal3_S2(gtsam.Pose3(), gtsam.Cal3_S2(1000.0, 1000.0, 0.0, 500.0, 500.0))
    graph = gtsam.NonlinearFactorGraph()
    graph.add(projection_factor(KEY, camera.project(POINT_M), noise_model(2, 3.0), camera))
    graph.add(depth_factor(KEY, POINT_M, RAY, SIGMA_M, "cauchy", 1.5))
    found_m = (
        gtsam.LevenbergMarquardtOptimizer(graph, at(POINT_M + np.array([0.2, 0.1, -0.5]))).optimize().atPoint3(KEY)
    )
    np.testing.assert_allclose(found_m, POINT_M, atol=1e-4)
