"""Medians of what is known."""

from __future__ import annotations

import numpy as np
import pytest

from fgpose_factors.robust_statistics import known_median, known_medians, known_quantile, lower_medians, medians

VALUES = np.array([[3.0, np.nan, 1.0, 2.0], [np.nan, 4.0, np.nan, 1.0], [np.nan, np.nan, np.nan, np.nan]])


@pytest.mark.parametrize("axis", [0, -1])
def test_of_many(axis: int) -> None:
    values = np.moveaxis(VALUES, -1, axis)
    np.testing.assert_array_equal(known_medians(values, axis), [2.0, 2.5, np.nan])
    np.testing.assert_array_equal(lower_medians(values, axis), [2.0, 1.0, np.nan])


@pytest.mark.parametrize("axis", [0, -1])
@pytest.mark.parametrize("n_values", [1, 4, 5])
def test_of_finite_values_as_numpy_has_them(axis: int, n_values: int) -> None:
    values = np.moveaxis(np.random.default_rng(0).normal(size=(3, n_values)), -1, axis)
    np.testing.assert_array_equal(medians(values, axis), np.median(values, axis=axis))


def test_of_all() -> None:
    assert known_median(VALUES) == known_quantile(VALUES, 0.5) == 2.0
    assert np.isnan(known_median(VALUES[2]))
    assert np.isnan(known_quantile(VALUES[2], 0.9))
