"""Checks for tests of factors: Jacobians against central differences."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import gtsam
import numpy as np


def numerical_jacobians(
    residual: Callable[..., np.ndarray], arguments: Sequence[np.ndarray], step: float = 1e-6
) -> list[np.ndarray]:
    """Jacobian of a residual (d,) by each argument (n,), by central differences."""
    jacobians = []
    for index, argument in enumerate(arguments):
        columns = []
        for k in range(argument.size):
            shift = np.zeros_like(argument, dtype=float)
            shift.flat[k] = step
            ahead = [*arguments[:index], argument + shift, *arguments[index + 1 :]]
            behind = [*arguments[:index], argument - shift, *arguments[index + 1 :]]
            columns.append((residual(*ahead) - residual(*behind)) / (2 * step))
        jacobians.append(np.stack(columns, axis=-1))
    return jacobians


def numerical_linearization(
    factor: gtsam.NoiseModelFactor, values: gtsam.Values, step: float = 1e-6
) -> tuple[np.ndarray, np.ndarray]:
    """Jacobian A (d, sum of n) and right-hand side b (d,) of a whitened factor, by central differences over retract.

    Compare with ``factor.linearize(values).jacobian()``. For a factor without a robust kernel.
    """
    whiten = factor.noiseModel().whiten
    columns = []
    for key in list(factor.keys()):
        for k in range(values.dims()[key]):
            ahead, behind = (_moved(values, key, k, sign * step) for sign in (1, -1))
            difference = factor.unwhitenedError(ahead) - factor.unwhitenedError(behind)
            columns.append(whiten(difference / (2 * step)))
    return np.stack(columns, axis=-1), -whiten(factor.unwhitenedError(values))


def _moved(values: gtsam.Values, key: int, component: int, step: float) -> gtsam.Values:
    delta = np.zeros(values.dims()[key])
    delta[component] = step
    move = gtsam.VectorValues()
    move.insert(key, delta)
    return values.retract(move)
