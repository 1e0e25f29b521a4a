"""The one adapter from a pure residual function to a GTSAM CustomFactor, and freezing a factor."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import gtsam
import numpy as np

Residual = Callable[..., tuple[np.ndarray, tuple[np.ndarray, ...]]]
"""Takes one array per key; returns the residual (d,) and one Jacobian (d, n) per key."""


def custom_factor(
    keys: Sequence[int],
    noise: gtsam.noiseModel.Base,
    residual: Residual,
    read: Sequence[Callable[[gtsam.Values, int], Any]],
) -> gtsam.CustomFactor:
    """A factor whose error and Jacobians are those of a pure function.

    Inside a C++ optimiser every evaluation copies all Values: 1.7 ms at 10,000 variables, so a batch optimiser becomes
    quadratic in the length of a recording. Linearise from Python, or freeze the factor.

    Args:
        keys: one per argument of the residual.
        noise: its dimension is the residual's.
        residual: see Residual.
        read: for each key, how to read it from Values, for example ``gtsam.Values.atPoint3``.

    Raises:
        ValueError: there are not as many readers as keys.
    """
    if len(keys) != len(read):
        raise ValueError(f"{len(keys)} keys need as many readers, got {len(read)}")

    def error(factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: gtsam.JacobianVector | None) -> np.ndarray:
        arguments = [reader(values, key) for reader, key in zip(read, factor.keys(), strict=True)]
        value, derivatives = residual(*arguments)
        if jacobians is not None:
            for index, derivative in enumerate(derivatives):
                jacobians[index] = np.asfortranarray(derivative)
        return value

    return gtsam.CustomFactor(noise, list(keys), error)


def freeze(factor: gtsam.NonlinearFactor, values: gtsam.Values) -> gtsam.LinearContainerFactor:
    """The factor linearised once at these values: no Python callback is left.

    The error is second order: 2 cm of sideways motion of a 30 cm bone changes its length by 0.7 mm.
    """
    own = values.extract(list(factor.keys()))
    return gtsam.LinearContainerFactor(factor.linearize(own), own)
