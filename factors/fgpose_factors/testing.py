"""Checks for tests of factors: Jacobians against central differences."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import gtsam
import numpy as np
from jaxtyping import Float


def numerical_jacobians(
    residual: Callable[..., Float[np.ndarray, " residual"]], arguments: Sequence[np.ndarray], step: float = 1e-6
) -> list[Float[np.ndarray, "residual _"]]:
    """Jacobian of a residual by each of its arguments, by central differences."""
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
) -> tuple[Float[np.ndarray, "residual variables"], Float[np.ndarray, " residual"]]:
    """Jacobian A (all variables side by side) and right-hand side b of a whitened factor, by central differences.

    The variables move by retract. Compare with ``factor.linearize(values).jacobian()``; for noise without a kernel.
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
