"""Levenberg-Marquardt over any least-squares problem: the graph of one frame, or a recording in either form."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar, runtime_checkable

from fgpose.trajectory import Convergence

# In 1/m^2: holds a joint like a prior of 10 cm.
_DAMPING_START = 1e2
_DAMPING_FACTOR = 10.0
_DAMPING_MAX = 1e10
_MIN_RELATIVE_DECREASE = 1e-7
# Where bones bend the cost, a whole step goes too far though its direction is good. A fraction of it costs no
# factorisation, and goes on where damping would stop: along what is poorly determined.
_FRACTIONS = (0.5, 0.25)
# That the direction is good shows in the error: it falls by at least so much of what the linear system predicts.
_SUFFICIENT = 0.25
_ROUNDING = 1e-12

State = TypeVar("State")
Step = TypeVar("Step")


@runtime_checkable
class Linearized(Protocol[Step]):
    """The normal equations of a problem around a state."""

    def solve(self, damping: float) -> Step | None:
        """Step with the damping added to the diagonal; None when the system is indeterminate."""
        ...

    def predicted_decrease(self, step: Step, damping: float, fraction: float) -> float:
        """By how much a fraction of the step, which was solved with this damping, lowers the quadratic error. The
        damping itself costs nothing."""
        ...


@runtime_checkable
class Problem(Protocol[State, Step]):
    """A non-linear least-squares problem.

    Robust kernels enter by reweighting, which keeps the normal equations positive semidefinite, so that a sufficiently
    damped step always descends.
    """

    def error(self, state: State) -> float: ...

    def linearize(self, state: State) -> Linearized[Step]: ...

    def moved(self, state: State, step: Step, fraction: float) -> State:
        """The state after a fraction of the step."""
        ...

    def is_small(self, step: Step) -> bool:
        """Whether to stop after this step."""
        ...


@dataclass(frozen=True)
class Solution(Generic[State]):
    """Where the optimiser ended, and how."""

    state: State
    convergence: Convergence


def levenberg_marquardt(problem: Problem[State, Step], initial: State, max_iterations: int) -> Solution[State]:
    """Gauss-Newton steps; shortened, then damped (Levenberg), only when one fails to lower the error or the system is
    indeterminate."""
    state, error, damping = initial, problem.error(initial), 0.0
    initial_error = error
    for iteration in range(1, max_iterations + 1):
        descent = _descend(problem, state, error, damping)
        if descent is None:
            return Solution(state, Convergence(False, iteration, initial_error, error))
        decrease = error - descent.error
        state, error, damping = descent.state, descent.error, descent.next_damping
        if decrease <= _MIN_RELATIVE_DECREASE * error or (descent.damping == 0.0 and problem.is_small(descent.step)):
            return Solution(state, Convergence(True, iteration, initial_error, error))
    return Solution(state, Convergence(False, max_iterations, initial_error, error))


@dataclass(frozen=True)
class _Descent(Generic[State, Step]):
    state: State
    step: Step
    error: float
    damping: float
    next_damping: float
    """A shortened step is followed by a damped one: where single joints swing to and fro, only that ends it."""


def _descend(problem: Problem[State, Step], state: State, error: float, damping: float) -> _Descent[State, Step] | None:
    """The longest of the least damped steps that does not raise the error; None when no damping helps."""
    linearized = problem.linearize(state)
    while damping <= _DAMPING_MAX:
        step = linearized.solve(damping)
        if step is not None:
            moved = problem.moved(state, step, 1.0)
            moved_error = problem.error(moved)
            if moved_error <= error * (1 + _ROUNDING):
                relaxed = damping / _DAMPING_FACTOR if damping > _DAMPING_START else 0.0
                return _Descent(moved, step, moved_error, damping, relaxed)
            for fraction in _FRACTIONS:
                moved = problem.moved(state, step, fraction)
                moved_error = problem.error(moved)
                if error - moved_error >= _SUFFICIENT * linearized.predicted_decrease(step, damping, fraction):
                    return _Descent(moved, step, moved_error, damping, max(damping, _DAMPING_START))
        damping = max(damping * _DAMPING_FACTOR, _DAMPING_START)
    return None
