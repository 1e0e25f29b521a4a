"""Distances of capsules from capsules and boxes, and the quantile, against Monte Carlo."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import ArrayLike
from scipy.optimize import minimize_scalar

from fgpose.geometry.segments import nearest_on_segments
from fgpose.robot.clearance import Axes, Shapes, clearance

NO_BOXES = np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 4, 4))
NO_CAPSULES = np.zeros((0, 2, 3)), np.zeros(0)


def axes(ends_m: ArrayLike, covariance_m2: np.ndarray | None = None, radius_m: float = 0.0) -> Axes:
    """Capsules with ends at one joint each."""
    ends_m = np.array(ends_m, dtype=float)
    if covariance_m2 is None:
        covariance_m2 = np.zeros((*ends_m.shape, 3))
    both = np.repeat(covariance_m2[:, :, None], 2, axis=2)
    return Axes(ends_m, both, np.full(len(ends_m), radius_m), (ends_m[:, 0] == ends_m[:, 1]).all(axis=-1))


def boxes(low_m: list[float], high_m: list[float], world_T_box: np.ndarray | None = None) -> Shapes:
    pose = np.eye(4) if world_T_box is None else world_T_box
    return Shapes(*NO_CAPSULES, np.array([low_m], dtype=float), np.array([high_m], dtype=float), pose[None])


def capsule(from_m: ArrayLike, to_m: ArrayLike, radius_m: float) -> Shapes:
    return Shapes(np.array([[from_m, to_m]], dtype=float), np.array([radius_m]), *NO_BOXES)


def test_known_distances_of_capsules() -> None:
    upright = axes([[[0, 0, 0], [0, 0, 2]], [[3, 0, 1], [3, 0, 1]]], radius_m=0.1)
    found = clearance(upright, capsule([1, -1, 1.5], [1, 1, 1.5], 0.2), 0.99)
    # Exact arithmetic but for rounding.
    np.testing.assert_allclose(found.expected_m[:, 0], [1.0 - 0.3, np.hypot(2.0, 0.5) - 0.3], atol=1e-9)
    np.testing.assert_allclose(found.least_m, found.expected_m, atol=1e-9)
    assert found.along[0, 0] == pytest.approx(0.75)


def test_known_distances_of_a_turned_box() -> None:
    # A cube of 2 m turned by 45 degrees about z: its edge is sqrt(2) m from its centre at (5, 0, 0).
    turned = np.eye(4)
    turned[:2, :2] = np.array([[1, -1], [1, 1]]) / np.sqrt(2)
    turned[0, 3] = 5.0
    upright = axes([[[0, 0, -3], [0, 0, 3]], [[5, 0, -3], [5, 0, 3]], [[5, 0, 1.5], [5, 0, 4]]], radius_m=0.1)
    found = clearance(upright, boxes([-1, -1, -1], [1, 1, 1], turned), 0.99)
    assert found.expected_m[0, 0] == pytest.approx(5 - np.sqrt(2) - 0.1, abs=1e-9)
    # Along the middle of the box, 1 m below its faces.
    assert found.expected_m[1, 0] == pytest.approx(-1.0 - 0.1, abs=1e-9)
    assert found.expected_m[2, 0] == pytest.approx(0.5 - 0.1, abs=1e-9)


def test_the_nearest_point_of_a_box_is_that_of_a_minimiser() -> None:
    rng = np.random.default_rng(0)
    ends_m = rng.normal(scale=2.0, size=(200, 2, 3))
    ends_m[::5, 1, 1:] = ends_m[::5, 0, 1:]  # along an edge
    ends_m[1::5, 1] = ends_m[1::5, 0]  # points
    low_m, high_m = np.array([-0.5, -0.2, -1.0]), np.array([0.5, 0.4, 0.3])
    found = clearance(axes(ends_m), boxes(low_m.tolist(), high_m.tolist()), 0.99)
    for (start_m, end_m), distance_m in zip(ends_m, found.expected_m[:, 0], strict=True):

        def outside_m(along: float, start_m: np.ndarray = start_m, end_m: np.ndarray = end_m) -> float:
            point_m = start_m + along * (end_m - start_m)
            return float(np.linalg.norm(np.maximum(np.maximum(low_m - point_m, point_m - high_m), 0.0)))

        best = minimize_scalar(outside_m, bounds=(0.0, 1.0), method="bounded", options={"xatol": 1e-9})
        least_m = min(outside_m(along) for along in (best.x, 0.0, 1.0))  # type: ignore[attr-defined]
        # Convex, so the minimiser cannot be caught elsewhere; it ends within 1e-8 of the segment's length.
        assert max(distance_m, 0.0) == pytest.approx(least_m, abs=1e-6)


def random_covariances(rng: np.random.Generator, n: int, sigma_m: float) -> np.ndarray:
    root = rng.normal(scale=sigma_m, size=(n, 2, 3, 3))
    return root @ root.swapaxes(-1, -2)


def test_the_quantile_holds_for_capsules_whatever_the_correlation_of_their_ends() -> None:
    rng = np.random.default_rng(1)
    robot = np.array([[0.0, 0.0, 0.5], [0.0, 0.0, 1.0]])
    n_samples, quantile = 20_000, 0.95
    shares = []
    for correlated in (0.0, 0.9, -0.9):
        ends_m = rng.normal(scale=0.2, size=(20, 2, 3)) + np.array([0.6, 0.0, 0.9])
        covariance_m2 = random_covariances(rng, 20, 0.05)
        found = clearance(axes(ends_m, covariance_m2, 0.06), capsule(robot[0], robot[1], 0.1), quantile)
        root = np.linalg.cholesky(covariance_m2)
        white = rng.normal(size=(n_samples, 20, 2, 3))
        white[:, :, 1] = correlated * white[:, :, 0] + np.sqrt(1 - correlated**2) * white[:, :, 1]
        samples_m = ends_m + np.einsum("neij,snej->snei", root, white)
        *_, distance_m = nearest_on_segments(samples_m[:, :, 0], samples_m[:, :, 1], *robot)
        shares.append((distance_m - 0.16 < found.least_m[:, 0]).mean(axis=0))
    # Nearer than said in at most 5 % of the cases: plus four standard deviations of a share of 20,000 samples.
    assert np.max(shares) <= 0.05 + 4 * np.sqrt(0.05 * 0.95 / n_samples)
    # And not by being far too careful: the bound is off by the second end and by the roundness of the robot.
    assert np.median(shares) > 0.005


def test_the_quantile_of_a_sphere_beside_a_wall_is_exact() -> None:
    rng = np.random.default_rng(2)
    covariance_m2 = random_covariances(rng, 1, 0.05)
    covariance_m2[:, 1] = covariance_m2[:, 0]
    joint_m = np.array([0.4, 0.0, 0.0])
    wall = boxes([-1, -50, -50], [0, 50, 50])
    found = clearance(axes(joint_m[None, None].repeat(2, axis=1), covariance_m2, 0.1), wall, 0.9)
    samples_m = rng.multivariate_normal(joint_m, covariance_m2[0, 0], size=100_000)
    # The wall is a plane, so the distance is normal. Four standard deviations of a share of 100,000 samples.
    share = (samples_m[:, 0] - 0.1 < found.least_m[0, 0]).mean()
    assert share == pytest.approx(0.1, abs=4 * np.sqrt(0.1 * 0.9 / 100_000))


def test_only_the_uncertainty_along_the_line_to_the_link_counts() -> None:
    along, across = (
        np.diag(np.square(sigma_m))[None, None].repeat(2, axis=1) for sigma_m in ((0.1, 0, 0), (0, 0.1, 0))
    )
    sphere = np.array([[[1.0, 0.0, 0.0]] * 2])
    ball = capsule([0, 0, 0], [0, 0, 0], 0.1)
    # 2.326: the 99 % quantile of the normal distribution.
    assert clearance(axes(sphere, along), ball, 0.99).least_m[0, 0] == pytest.approx(0.9 - 0.2326, abs=1e-4)
    assert clearance(axes(sphere, across), ball, 0.99).least_m[0, 0] == pytest.approx(0.9, abs=1e-9)


def test_an_uncertain_far_end_counts() -> None:
    # The elbow is nearest and certain; the wrist behind it may be anywhere within half a metre.
    arm = np.array([[[1.0, 0.0, 0.0], [1.3, 0.0, 0.0]]])
    covariance_m2 = np.stack([np.zeros((3, 3)), np.eye(3) * 0.5**2])[None]
    found = clearance(axes(arm, covariance_m2), capsule([0, 0, 0], [0, 0, 0], 0.1), 0.95)
    # 1.960: the quantile of the normal distribution whose tail is half of 5 %.
    assert found.least_m[0, 0] == pytest.approx(1.3 - 1.960 * 0.5 - 0.1, abs=1e-3)


def test_where_capsules_cross_the_largest_deviation_counts() -> None:
    crossing = np.array([[[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]])
    covariance_m2 = np.tile(np.diag(np.square([0.01, 0.02, 0.3])), (1, 2, 1, 1))
    found = clearance(axes(crossing, covariance_m2), capsule([0, -1, 0], [0, 1, 0], 0.1), 0.95)
    assert found.expected_m[0, 0] == pytest.approx(-0.1, abs=1e-6)
    assert found.least_m[0, 0] == pytest.approx(-0.1 - 1.960 * 0.3, abs=1e-3)
