"""Distances from a camera, from its 3D."""

from __future__ import annotations

import numpy as np

from fgpose.geometry.per_view.view_depth import ViewDepth

CAMERA_M = np.array([1.0, 2.0, 3.0])


def test_the_distance_and_its_deviation_are_those_along_the_ray() -> None:
    points_m = CAMERA_M + np.array([[0.0, 0.0, 2.0], [3.0, 4.0, 0.0]])
    covariance_m2 = np.stack([np.diag([0.01, 0.01, 0.25]) ** 2, np.diag([0.1, 0.2, 0.3]) ** 2])
    depth = ViewDepth.of(points_m, covariance_m2, CAMERA_M)
    np.testing.assert_allclose(depth.distance_m, [2.0, 5.0])
    np.testing.assert_allclose(depth.rays, [[0.0, 0.0, 1.0], [0.6, 0.8, 0.0]])
    np.testing.assert_allclose(depth.sigma_m, [0.25, np.hypot(0.6 * 0.1, 0.8 * 0.2)])


def test_what_is_not_known_stays_unknown() -> None:
    depth = ViewDepth.of(np.stack([np.full(3, np.nan), CAMERA_M]), None, CAMERA_M)
    assert np.isnan(depth.distance_m).all()
    assert np.isnan(depth.rays).all()
    assert np.isnan(ViewDepth.of(np.zeros((1, 3)), None, CAMERA_M).sigma_m).all()
