from __future__ import annotations

import gtsam
import numpy as np
import pytest

from fgpose_factors import (
    noise_model,
    shared_bone_length_factor,
    shared_length_residual,
    symmetric_bone_length_factor,
    symmetric_length_residual,
)
from fgpose_factors.testing import numerical_jacobians, numerical_linearization

A, B, C, D = (gtsam.symbol("x", joint) for joint in range(4))
LENGTH = gtsam.symbol("l", 0)
ZERO = np.zeros(3)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def at(**points: np.ndarray | float) -> gtsam.Values:
    keys = {"a": A, "b": B, "c": C, "d": D, "length": LENGTH}
    values = gtsam.Values()
    for name, value in points.items():
        values.insert(keys[name], value)
    return values


def test_symmetry_is_zero_for_equal_limbs_in_any_direction(rng):
    for _ in range(10):
        left, right = (gtsam.Rot3.Expmap(rng.normal(size=3)).matrix() @ [0, 0, 0.3] for _ in range(2))
        start, other = rng.normal(size=(2, 3))
        residual, _ = symmetric_length_residual(start, start + left, other, other + right)
        np.testing.assert_allclose(residual, 0.0, atol=1e-15)


def test_symmetry_is_the_difference_in_metres():
    left, right = (ZERO, np.array([0.31, 0, 0])), (ZERO, np.array([0, 0.28, 0]))
    residual, _ = symmetric_length_residual(*left, *right)
    np.testing.assert_allclose(residual, [0.03])
    factor = symmetric_bone_length_factor((A, B), (C, D), noise_model(1, 0.03))
    # an asymmetry of one sigma costs one half
    assert factor.error(at(a=left[0], b=left[1], c=right[0], d=right[1])) == pytest.approx(0.5)


def test_left_and_right_swapped_change_the_sign_only(rng):
    a, b, c, d = rng.normal(size=(4, 3))
    residual, jacobians = symmetric_length_residual(a, b, c, d)
    swapped, swapped_jacobians = symmetric_length_residual(c, d, a, b)
    np.testing.assert_allclose(swapped, -residual, rtol=1e-15)
    for jacobian, other in zip(jacobians, swapped_jacobians[2:] + swapped_jacobians[:2], strict=True):
        np.testing.assert_array_equal(jacobian, -other)


def test_lengths_do_not_change_when_the_body_moves_as_a_whole(rng):
    points_m = rng.normal(size=(4, 3))
    motion = gtsam.Pose3(gtsam.Rot3.Expmap(rng.normal(size=3)), rng.normal(size=3))
    moved_m = np.stack([motion.transformFrom(point_m) for point_m in points_m])
    # rounding of coordinates of a few metres
    np.testing.assert_allclose(
        symmetric_length_residual(*moved_m)[0], symmetric_length_residual(*points_m)[0], atol=1e-14
    )
    np.testing.assert_allclose(
        shared_length_residual(moved_m[0], moved_m[1], 0.3)[0],
        shared_length_residual(points_m[0], points_m[1], 0.3)[0],
        atol=1e-14,
    )


def test_jacobians_equal_central_differences(rng):
    for _ in range(20):
        points_m = list(rng.normal(size=(4, 3)))
        _, jacobians = symmetric_length_residual(*points_m)
        expected = numerical_jacobians(lambda *p: symmetric_length_residual(*p)[0], points_m)
        for jacobian, numerical in zip(jacobians, expected, strict=True):
            np.testing.assert_allclose(jacobian, numerical, atol=1e-8)  # rounding of 1 m / 1e-6 m: 1e-10
        arguments = [*points_m[:2], np.array([0.3])]
        _, jacobians = shared_length_residual(points_m[0], points_m[1], 0.3)
        expected = numerical_jacobians(lambda p, q, length: shared_length_residual(p, q, length[0])[0], arguments)
        for jacobian, numerical in zip(jacobians, expected, strict=True):
            np.testing.assert_allclose(jacobian, numerical, atol=1e-8)


def test_the_factors_linearise_as_they_evaluate(rng):
    a, b, c, d = rng.normal(size=(4, 3))
    symmetric = symmetric_bone_length_factor((A, B), (C, D), noise_model(1, 0.02))
    shared = shared_bone_length_factor((A, B), LENGTH, noise_model(1, 0.02))
    for factor, values in ((symmetric, at(a=a, b=b, c=c, d=d)), (shared, at(a=a, b=b, length=0.4))):
        A_matrix, right_hand_side = factor.linearize(values).jacobian()
        numerical_A, numerical_b = numerical_linearization(factor, values)
        np.testing.assert_allclose(A_matrix, numerical_A, atol=1e-6)  # 1e-8 / sigma
        np.testing.assert_allclose(right_hand_side, numerical_b, rtol=1e-12)


def test_shared_length_is_zero_at_the_truth_and_the_excess_in_metres_elsewhere():
    end_m = np.array([0.0, 0.3, 0.4])
    np.testing.assert_allclose(shared_length_residual(ZERO, end_m, 0.5)[0], [0.0], atol=1e-15)
    np.testing.assert_allclose(shared_length_residual(ZERO, end_m, 0.48)[0], [0.02])


def test_with_a_length_that_is_known_it_is_gtsams_range_factor(rng):
    noise = noise_model(1, 0.01)
    for _ in range(10):
        a, b = rng.normal(size=(2, 3))
        shared = shared_bone_length_factor((A, B), LENGTH, noise)
        native = gtsam.RangeFactor3(A, B, 0.4, noise)
        values = at(a=a, b=b, length=0.4)
        assert shared.error(values) == pytest.approx(native.error(values), rel=1e-12)
        ours, theirs = shared.linearize(values).jacobian(), native.linearize(values).jacobian()
        np.testing.assert_allclose(ours[0][:, :6], theirs[0], rtol=1e-12)
        np.testing.assert_allclose(ours[1], theirs[1], rtol=1e-12)


@pytest.mark.parametrize("residual", [symmetric_length_residual, shared_length_residual])
def test_a_bone_of_length_zero_has_a_residual_and_no_direction(residual):
    rest = (ZERO, np.array([0.0, 0.0, 0.3])) if residual is symmetric_length_residual else (0.3,)
    value, jacobians = residual(ZERO, ZERO, *rest)
    np.testing.assert_allclose(value, [-0.3])
    np.testing.assert_array_equal(jacobians[0], 0.0)
    np.testing.assert_array_equal(jacobians[1], 0.0)


def test_the_symmetry_factor_makes_limbs_equal_and_moves_nothing_else():
    """Two limbs held by equally strong priors meet in the middle, along their own directions."""
    graph = gtsam.NonlinearFactorGraph()
    initial = at(a=ZERO, b=np.array([0.32, 0, 0]), c=ZERO, d=np.array([0, 0, 0.28]))
    for key, sigma_m in ((A, 1e-5), (B, 0.05), (C, 1e-5), (D, 0.05)):
        graph.add(gtsam.PriorFactorPoint3(key, initial.atPoint3(key), noise_model(3, sigma_m)))
    graph.add(symmetric_bone_length_factor((A, B), (C, D), noise_model(1, 1e-5)))
    result = gtsam.LevenbergMarquardtOptimizer(graph, initial).optimize()
    # the priors give way by (1e-5 / 0.05)^2 of 2 cm
    np.testing.assert_allclose(result.atPoint3(B), [0.30, 0, 0], atol=1e-6)
    np.testing.assert_allclose(result.atPoint3(D), [0, 0, 0.30], atol=1e-6)


def test_many_bones_at_once_are_one_after_the_other(rng):
    points_m, lengths_m = rng.normal(size=(4, 5, 2, 3)), rng.normal(size=(5, 2))
    points_m[1, 3, 1] = points_m[0, 3, 1]
    for residual, arguments in (
        (symmetric_length_residual, list(points_m)),
        (shared_length_residual, [*points_m[:2], lengths_m]),
    ):
        values, jacobians = residual(*arguments)
        for bone in np.ndindex(5, 2):
            value, own_jacobians = residual(*(argument[bone] for argument in arguments))
            np.testing.assert_array_equal(values[bone], value)
            for jacobian, own in zip(jacobians, own_jacobians, strict=True):
                np.testing.assert_array_equal(jacobian[bone], own)
