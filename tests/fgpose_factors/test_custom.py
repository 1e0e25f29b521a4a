from __future__ import annotations

import gtsam
import numpy as np
import pytest

from fgpose_factors import custom_factor, freeze, noise_model, symmetric_bone_length_factor
from fgpose_factors.testing import numerical_jacobians, numerical_linearization

A, B, C, D = (gtsam.symbol("x", joint) for joint in range(4))
OTHER = gtsam.symbol("x", 9)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def difference(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
    return b - a, (-np.eye(3), np.eye(3))


def points(values_m: np.ndarray) -> gtsam.Values:
    values = gtsam.Values()
    for key, point_m in zip((A, B, C, D), values_m, strict=False):
        values.insert(key, point_m)
    return values


def test_a_pure_function_becomes_a_factor(rng):
    noise = noise_model(3, 0.1)
    ours = custom_factor((A, B), noise, difference, (gtsam.Values.atPoint3,) * 2)
    native = gtsam.BetweenFactorPoint3(A, B, np.zeros(3), noise)
    values = points(rng.normal(size=(2, 3)))
    assert ours.error(values) == pytest.approx(native.error(values), rel=1e-12)
    for own, theirs in zip(ours.linearize(values).jacobian(), native.linearize(values).jacobian(), strict=True):
        np.testing.assert_allclose(own, theirs, rtol=1e-12)


def test_it_works_inside_gtsams_own_optimiser(rng):
    graph = gtsam.NonlinearFactorGraph()
    graph.add(gtsam.PriorFactorPoint3(A, np.array([1.0, 2.0, 3.0]), noise_model(3, 0.1)))
    graph.add(custom_factor((A, B), noise_model(3, 0.1), difference, (gtsam.Values.atPoint3,) * 2))
    result = gtsam.LevenbergMarquardtOptimizer(graph, points(rng.normal(size=(2, 3)))).optimize()
    np.testing.assert_allclose(result.atPoint3(B), [1.0, 2.0, 3.0], atol=1e-6)  # the optimiser's default is 1e-5


def test_it_survives_the_names_that_it_was_made_from(rng):
    """GTSAM holds the callback; nothing else does."""
    graph = gtsam.NonlinearFactorGraph()
    for _ in range(3):
        graph.add(symmetric_bone_length_factor((A, B), (C, D), noise_model(1, 0.1)))
    values = points(rng.normal(size=(4, 3)))
    assert graph.error(values) == pytest.approx(3 * graph.at(0).error(values))


def test_one_reader_too_few_is_refused():
    with pytest.raises(ValueError, match="2 keys need as many readers, got 1"):
        custom_factor((A, B), noise_model(3, 0.1), difference, (gtsam.Values.atPoint3,))


def test_frozen_it_is_the_linearisation_at_these_values_among_others(rng):
    factor = symmetric_bone_length_factor((A, B), (C, D), noise_model(1, 0.02))
    values = points(rng.normal(size=(4, 3)))
    values.insert(OTHER, rng.normal(size=3))
    frozen = freeze(factor, values)
    for own, theirs in zip(frozen.linearize(values).jacobian(), factor.linearize(values).jacobian(), strict=True):
        np.testing.assert_allclose(own, theirs, rtol=1e-12)
    assert frozen.error(values) == pytest.approx(factor.error(values), rel=1e-12)
    assert list(frozen.keys()) == [A, B, C, D]


def test_frozen_it_neglects_seven_tenths_of_a_millimetre_for_2_cm_sideways_on_a_30_cm_bone():
    sigma_m = 0.01
    factor = symmetric_bone_length_factor((A, B), (C, D), noise_model(1, sigma_m))
    equal_m = np.array([[0, 0, 0], [0, 0, 0.3], [0.5, 0, 0], [0.5, 0, 0.3]], dtype=float)
    frozen = freeze(factor, points(equal_m))
    for sideways_m, neglected_m in ((0.02, 0.000666), (0.01, 0.000167)):
        moved_m = equal_m.copy()
        moved_m[1, 0] += sideways_m
        assert frozen.error(points(moved_m)) == pytest.approx(0.0, abs=1e-12)
        # hypot(0.3, s) - 0.3: half the motion, a quarter of the error
        assert np.sqrt(2 * factor.error(points(moved_m))) * sigma_m == pytest.approx(neglected_m, abs=1e-6)


def test_the_numerical_checks_find_a_wrong_jacobian(rng):
    def wrong(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
        return b - a, (-np.eye(3), 2 * np.eye(3))

    values_m = rng.normal(size=(2, 3))
    numerical = numerical_jacobians(lambda a, b: wrong(a, b)[0], list(values_m))
    assert np.abs(numerical[1] - wrong(*values_m)[1][1]).max() > 0.9
    factor = custom_factor((A, B), noise_model(3, 1.0), wrong, (gtsam.Values.atPoint3,) * 2)
    A_matrix, _ = factor.linearize(points(values_m)).jacobian()
    expected, _ = numerical_linearization(factor, points(values_m))
    assert np.abs(A_matrix - expected).max() > 0.9
