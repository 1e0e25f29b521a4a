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
    """The factors of a graph (a levenberg_marquardt.Problem over gtsam.Values).

    Args:
        factors: must not change afterwards: the elimination ordering of the first linear system is kept.
        step_tolerance_m: see levenberg_marquardt.Problem.
    """

    def __init__(self, factors: gtsam.NonlinearFactorGraph, step_tolerance_m: float) -> None:
        self.graph = factors
        self.step_tolerance = step_tolerance_m
        self._ordering: gtsam.Ordering | None = None
        self._linearized: tuple[gtsam.Values, gtsam.GaussianFactorGraph] | None = None

    def error(self, state: gtsam.Values) -> float:
        return self.graph.error(state)

    def gaussian(self, state: gtsam.Values) -> gtsam.GaussianFactorGraph:
        """All factors, linearised."""
        return self.graph.linearize(state)

    @property
    def damping_scale(self) -> Float[np.ndarray, " unknown"]:
        """All unknowns here are positions."""
        return np.ones(3 * len(list(self.graph.keyVector())))

    def gradient(self, state: gtsam.Values) -> Float[np.ndarray, " unknown"]:
        return self._linear(state).gradientAtZero().vector()

    def factorized(self, state: gtsam.Values, damping: float) -> FactorizedGraph | None:
        linear = self._linear(state)
        ordering = self._ordering = self._ordering or gtsam.Ordering.ColamdGaussianFactorGraph(linear)
        try:
            damped = _damped(linear, damping * self.damping_scale, state)
            return FactorizedGraph(damped.eliminateSequential(ordering), state)
        except RuntimeError:  # gtsam.IndeterminantLinearSystemException
            return None

    def moved(self, state: gtsam.Values, step: Float[np.ndarray, " unknown"]) -> gtsam.Values:
        return state.retract(_by_key(step, state))

    def step_size(self, step: Float[np.ndarray, " unknown"]) -> float:
        return float(np.linalg.norm(self.moves_m(step), axis=1).max(initial=0.0))

    def moves_m(self, step: Float[np.ndarray, " unknown"]) -> Float[np.ndarray, "point 3"]:
        """The part of a step that moves positions; here, all of it."""
        return step.reshape(-1, 3)

    def _linear(self, state: gtsam.Values) -> gtsam.GaussianFactorGraph:
        """All factors, linearised: once for the gradient and the factorisation of a state."""
        if self._linearized is None or self._linearized[0] is not state:
            self._linearized = state, self.gaussian(state)
        return self._linearized[1]


@dataclass(frozen=True)
class FactorizedGraph:
    """The eliminated linear system of a graph, R^T R."""

    bayes_net: gtsam.GaussianBayesNet
    values: gtsam.Values

    def solve(self, right_hand_side: Float[np.ndarray, " unknown"]) -> Float[np.ndarray, " unknown"]:
        try:
            forward = self.bayes_net.backSubstituteTranspose(_by_key(right_hand_side, self.values))
            return self.bayes_net.backSubstitute(forward).vector()
        except RuntimeError:  # gtsam.IndeterminantLinearSystemException, which elimination alone does not raise for NaN
            return np.full_like(right_hand_side, np.nan)


def _by_key(vector: Float[np.ndarray, " unknown"], values: gtsam.Values) -> gtsam.VectorValues:
    """A vector in the order of the keys, as GTSAM's own type."""
    of_keys, start = gtsam.VectorValues(), 0
    for key, dim in sorted(values.dims().items()):
        of_keys.insert(key, vector[start : start + dim])
        start += dim
    return of_keys


def _damped(
    linear: gtsam.GaussianFactorGraph, precision: Float[np.ndarray, " unknown"], values: gtsam.Values
) -> gtsam.GaussianFactorGraph:
    if not precision.any():
        return linear
    system, start = linear.clone(), 0
    for key, dim in sorted(values.dims().items()):
        root = np.diag(np.sqrt(precision[start : start + dim]))
        system.add(gtsam.JacobianFactor(key, root, np.zeros(dim), gtsam.noiseModel.Unit.Create(dim)))
        start += dim
    return system
