"""Anderson acceleration of an iteration x -> x + s(x).

The steps of the last iterations tell how the step changes with the state, as the secants of a quasi-Newton method do:
what creeps along one direction, or swings to and fro along it, is carried to its end at once (Walker and Ni 2011,
"Anderson acceleration for fixed-point iterations", type II). Costs a few inner products.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

_MOST_SECANTS = 5
# Relative to the mean square of the secants: of two that are parallel to rounding, one counts.
_RIDGE = 1e-10

Vector = Float[np.ndarray, " unknown"]


class AndersonAcceleration:
    """The last steps of the iteration, and where they were left."""

    def __init__(self) -> None:
        self._steps: list[Vector] = []
        self._taken: list[Vector] = []

    def forget(self) -> None:
        """Start anew: the iteration is another one from now on."""
        self._steps, self._taken = [], []

    def add(self, step: Vector, taken: Vector) -> None:
        """Remember the step that the iteration proposed, and the one that was taken."""
        self._steps = [*self._steps[1 - _MOST_SECANTS :], step]
        self._taken = [*self._taken[1 - _MOST_SECANTS :], taken]

    def extrapolated(self, step: Vector) -> Vector | None:
        """The step to where the next one would vanish, were the iteration linear; None with nothing to go by.

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
