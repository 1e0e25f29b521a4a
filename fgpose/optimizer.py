"""Levenberg-Marquardt over a GTSAM graph, driven from Python.

A C++ optimiser copies all Values for each Python callback; linearising from Python does not, and lets many factors be
linearised in one numpy expression.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import gtsam
import numpy as np

from fgpose.trajectory import Convergence

# In 1/m^2: holds a joint like a prior of 10 cm.
_DAMPING_START = 1e2
_DAMPING_FACTOR = 10.0
_DAMPING_MAX = 1e10
_MIN_RELATIVE_DECREASE = 1e-7
_ROUNDING = 1e-12


@runtime_checkable
class Problem(Protocol):
    """A non-linear least-squares problem over gtsam.Values."""

    def error(self, values: gtsam.Values) -> float: ...

    def linearize(self, values: gtsam.Values) -> gtsam.GaussianFactorGraph: ...


@dataclass(frozen=True)
class Solution:
    """Where the optimiser ended, and how."""

    values: gtsam.Values
    convergence: Convergence


def levenberg_marquardt(
    problem: Problem,
    initial: gtsam.Values,
    ordering: Callable[[gtsam.GaussianFactorGraph], gtsam.Ordering],
    max_iterations: int,
    small_step: Callable[[gtsam.VectorValues], bool],
) -> Solution:
    """Gauss-Newton steps, damped (Levenberg) only when one fails to lower the error or the system is indeterminate.

    Robust kernels enter by reweighting in GTSAM's linearisation, which keeps the normal equations positive definite, so
    that a sufficiently damped step always descends.

    Args:
        ordering: elimination ordering of the first linear system; it is kept, as the structure does not change.
        small_step: whether a step is small enough to stop after.
    """
    values, error, damping = initial, problem.error(initial), 0.0
    initial_error = error
    order: gtsam.Ordering | None = None
    for iteration in range(1, max_iterations + 1):
        linear = problem.linearize(values)
        order = order or ordering(linear)
        descent = _descend(problem, linear, order, values, error, damping)
        if descent is None:
            return Solution(values, Convergence(False, iteration, initial_error, error))
        decrease = error - descent.error
        values, error, damping = descent.values, descent.error, descent.damping
        undamped = damping == 0.0
        if decrease <= _MIN_RELATIVE_DECREASE * error or (undamped and small_step(descent.step)):
            return Solution(values, Convergence(True, iteration, initial_error, error))
        damping = damping / _DAMPING_FACTOR if damping > _DAMPING_START else 0.0
    return Solution(values, Convergence(False, max_iterations, initial_error, error))


@dataclass(frozen=True)
class _Descent:
    values: gtsam.Values
    step: gtsam.VectorValues
    error: float
    damping: float


def _descend(
    problem: Problem,
    linear: gtsam.GaussianFactorGraph,
    order: gtsam.Ordering,
    values: gtsam.Values,
    error: float,
    damping: float,
) -> _Descent | None:
    """The least damped step that does not raise the error; None when no damping helps."""
    while damping <= _DAMPING_MAX:
        step = _solve(linear, order, values, damping)
        if step is not None:
            moved = values.retract(step)
            moved_error = problem.error(moved)
            if moved_error <= error * (1 + _ROUNDING):
                return _Descent(moved, step, moved_error, damping)
        damping = max(damping * _DAMPING_FACTOR, _DAMPING_START)
    return None


def _solve(
    linear: gtsam.GaussianFactorGraph, order: gtsam.Ordering, values: gtsam.Values, damping: float
) -> gtsam.VectorValues | None:
    """The (damped) Gauss-Newton step, or None when the system is indeterminate."""
    system = linear if damping == 0.0 else _damped(linear, values, damping)
    try:
        step = system.optimize(order)
    except RuntimeError:  # gtsam.IndeterminantLinearSystemException
        return None
    return step if np.isfinite(step.norm()) else None


def _damped(linear: gtsam.GaussianFactorGraph, values: gtsam.Values, damping: float) -> gtsam.GaussianFactorGraph:
    system = linear.clone()
    models = {dim: gtsam.noiseModel.Isotropic.Precision(dim, damping) for dim in (1, 3)}
    for key, dim in values.dims().items():
        system.add(gtsam.JacobianFactor(key, np.eye(dim), np.zeros(dim), models[dim]))
    return system
