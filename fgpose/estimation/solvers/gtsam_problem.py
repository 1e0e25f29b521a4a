"""A GTSAM graph as an optimisation problem that is driven from Python.

A C++ optimiser copies all Values for each Python callback; linearising from Python does not, and lets many factors be
linearised in one numpy expression.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
from jaxtyping import Float


class GraphProblem:
    """The factors of a graph (an optimizer.Problem over gtsam.Values).

    Args:
        factors: must not change afterwards: the elimination ordering of the first linear system is kept.
        step_tolerance_m: see is_small.
    """

    def __init__(self, factors: gtsam.NonlinearFactorGraph, step_tolerance_m: float) -> None:
        self.graph = factors
        self.step_tolerance_m = step_tolerance_m
        self._ordering: gtsam.Ordering | None = None

    def error(self, state: gtsam.Values) -> float:
        return self.graph.error(state)

    def gaussian(self, state: gtsam.Values) -> gtsam.GaussianFactorGraph:
        """All factors, linearised."""
        return self.graph.linearize(state)

    def linearize(self, state: gtsam.Values) -> LinearizedGraph:
        linear = self.gaussian(state)
        self._ordering = self._ordering or gtsam.Ordering.ColamdGaussianFactorGraph(linear)
        return LinearizedGraph(linear, self._ordering, state)

    def moved(self, state: gtsam.Values, step: gtsam.VectorValues, fraction: float) -> gtsam.Values:
        return state.retract(step.scale(fraction))

    def is_small(self, step: gtsam.VectorValues) -> bool:
        """Whether the joints move by less than the tolerance on average."""
        moves_m = self.moves_m(step)
        return not moves_m.size or bool(np.linalg.norm(moves_m, axis=1).mean() < self.step_tolerance_m)

    def moves_m(self, step: gtsam.VectorValues) -> Float[np.ndarray, "point 3"]:
        """What a step moves in space; here, all of it."""
        return step.vector().reshape(-1, 3)


@dataclass(frozen=True)
class LinearizedGraph:
    """The linear system of a graph around its values."""

    linear: gtsam.GaussianFactorGraph
    ordering: gtsam.Ordering
    values: gtsam.Values

    def solve(self, damping: float) -> gtsam.VectorValues | None:
        system = self._damped(damping) if damping else self.linear
        try:
            step = system.optimize(self.ordering)
        except RuntimeError:  # gtsam.IndeterminantLinearSystemException
            return None
        return step if np.isfinite(step.norm()) else None

    def predicted_decrease(self, step: gtsam.VectorValues, damping: float, fraction: float) -> float:
        return self.linear.error(gtsam.VectorValues.Zero(step)) - self.linear.error(step.scale(fraction))

    def _damped(self, damping: float) -> gtsam.GaussianFactorGraph:
        system = self.linear.clone()
        models = {dim: gtsam.noiseModel.Isotropic.Precision(dim, damping) for dim in (1, 3)}
        for key, dim in self.values.dims().items():
            system.add(gtsam.JacobianFactor(key, np.eye(dim), np.zeros(dim), models[dim]))
        return system
