"""How covariances of points stand in a table: the upper triangle, one column for each entry."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

COVARIANCE_COLUMNS = {
    f"cov_{'xyz'[row]}{'xyz'[column]}_m2": (row, column)
    for row, column in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
}
"""Row and column of the entry by the name of its column."""


def symmetric(column: Callable[[str], np.ndarray]) -> Float[np.ndarray, "*points 3 3"]:
    """The covariances from their columns, each of the shape of the points."""
    entries = {entry: column(name) for name, entry in COVARIANCE_COLUMNS.items()}
    return np.stack([np.stack([entries[min(i, j), max(i, j)] for j in range(3)], axis=-1) for i in range(3)], axis=-2)
