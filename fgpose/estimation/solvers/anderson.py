"""Anderson acceleration of an iteration x -> x + s(x).

The differences between the last steps show how the step changes with the state (secants, as in a quasi-Newton method).
So slow or oscillating convergence along a direction ends at once (Walker and Ni 2011, "Anderson acceleration for
fixed-point iterations", type II). Costs a few inner products.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

# With more, steps count that were taken where the problem was still different; with fewer, fewer slow directions end.
_MOST_SECANTS = 5
# Relative to the mean square of the secants; keeps the system regular if two of them are parallel.
_RIDGE = 1e-10

Vector = Float[np.ndarray, " unknown"]


class AndersonAcceleration:
    """The last steps that the iteration proposed, and those that were taken."""

    def __init__(self) -> None:
        self._steps: list[Vector] = []
        self._taken: list[Vector] = []

    def forget(self) -> None:
        """Start again: the iteration has changed."""
        self._steps, self._taken = [], []

    def add(self, step: Vector, taken: Vector) -> None:
        """Remember the step that the iteration proposed, and the one that was taken."""
        self._steps = [*self._steps[1 - _MOST_SECANTS :], step]
        self._taken = [*self._taken[1 - _MOST_SECANTS :], taken]

    def extrapolated(self, step: Vector) -> Vector | None:
        """The step to the fixed point, if the iteration were linear; None without earlier steps.

        Args:
            step: that the iteration proposes at the present state.
        """
        if not self._steps:
            return None
        changes = np.diff([*self._steps, step], axis=0)
        products = changes @ changes.T
        ridge = _RIDGE * np.trace(products) * np.eye(len(products))
        try:
            coefficients = np.linalg.solve(products + ridge, changes @ step)
        except np.linalg.LinAlgError:  # the steps did not change at all
            return None
        return step - coefficients @ (np.array(self._taken) + changes)
