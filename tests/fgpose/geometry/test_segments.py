"""Nearest points of segments, against a dense grid and scipy's minimiser."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from fgpose.geometry.segments import nearest_on_segments


def point(segment: np.ndarray, along: float) -> np.ndarray:
    return segment[0] + along * (segment[1] - segment[0])


def random_segments(n: int, seed: int) -> np.ndarray:
    """(n, 2, 2, 3): pairs of segments, by turns in general position, points, parallel, on one line, crossing."""
    rng = np.random.default_rng(seed)
    pairs = rng.normal(size=(n, 2, 2, 3))
    pairs[1::6, 0, 1] = pairs[1::6, 0, 0]
    pairs[2::6, :, 1] = pairs[2::6, :, 0]
    pairs[3::6, 1, 1] = pairs[3::6, 1, 0] + 0.7 * (pairs[3::6, 0, 1] - pairs[3::6, 0, 0])
    pairs[4::6, 1] = pairs[4::6, 0, :1] + rng.normal(size=(len(pairs[4::6]), 2, 1)) * (
        pairs[4::6, 0, 1:] - pairs[4::6, 0, :1]
    )
    pairs[5::6, 1, 1] = 2 * pairs[5::6, 0].mean(axis=1) - pairs[5::6, 1, 0]
    return pairs


def test_no_pair_on_a_grid_is_nearer() -> None:
    pairs = random_segments(120, seed=0)
    _, _, distance_m = nearest_on_segments(pairs[:, 0, 0], pairs[:, 0, 1], pairs[:, 1, 0], pairs[:, 1, 1])
    steps = np.linspace(0.0, 1.0, 101)
    a, b = (
        pairs[:, side, None, 0] + steps[:, None] * (pairs[:, side, 1] - pairs[:, side, 0])[:, None] for side in (0, 1)
    )
    grid_m = np.linalg.norm(a[:, :, None] - b[:, None], axis=-1).min(axis=(1, 2))
    # Rounding leaves 1e-7 m where segments touch. The grid misses by at most half a step of each: 0.005 of its length.
    lengths_m = np.linalg.norm(pairs[:, :, 1] - pairs[:, :, 0], axis=-1).sum(axis=1)
    assert (distance_m <= grid_m + 1e-7).all()
    assert (distance_m >= grid_m - 0.005 * lengths_m - 1e-7).all()


def test_a_minimiser_agrees() -> None:
    for pair in random_segments(60, seed=1):
        along_a, along_b, distance_m = nearest_on_segments(*pair[0], *pair[1])
        found = minimize(
            lambda along, pair=pair: float(np.sum((point(pair[0], along[0]) - point(pair[1], along[1])) ** 2)),
            (0.5, 0.5),
            bounds=[(0.0, 1.0)] * 2,
            options={"ftol": 1e-15, "gtol": 1e-10},
        )
        # The minimiser ends within 1e-8 m^2 of the least square, 1e-4 m where the segments touch.
        assert float(distance_m) == pytest.approx(np.sqrt(found.fun), abs=2e-4)
        own_m = np.linalg.norm(point(pair[0], float(along_a)) - point(pair[1], float(along_b)))
        assert own_m == pytest.approx(float(distance_m), abs=1e-6)


def test_known_distances() -> None:
    origin, x, y, z = np.zeros(3), *np.eye(3)
    for ends, expected_m in (
        ((origin, x, y, x + y), 1.0),  # parallel
        ((origin, x, x + y + z, x + 2 * y + z), np.sqrt(2)),  # an end from an inner point of neither
        ((-x, x, z - y, z + y), 1.0),  # crossing over each other
        ((origin, origin, x, x), 1.0),  # two points
        ((origin, x, 3 * x, 5 * x), 2.0),  # on one line
    ):
        assert float(nearest_on_segments(*ends)[2]) == pytest.approx(expected_m, abs=1e-9)
