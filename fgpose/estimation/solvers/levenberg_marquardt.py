"""Levenberg-Marquardt over any least-squares problem: the graph of one frame, or a recording in either form.

Where joints are barely determined, the textbook method oscillates or converges slowly. Five additions avoid this at
little cost: the damping follows the gain ratio (Nielsen 1999, "Damping parameter in Marquardt's method"), a step is
corrected for residuals that bend within it (as by Transtrum and Sethna 2012, "Improvements to the Levenberg-Marquardt
algorithm for nonlinear least-squares minimization", with the whole remainder instead of its second order), a
factorisation serves for several iterations while they contract (the chord method), the steps of several iterations
are combined (fgpose.estimation.solvers.anderson), and steps that do not contract are prolonged.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar, runtime_checkable

import numpy as np
from jaxtyping import Float

from fgpose.estimation.solvers.anderson import AndersonAcceleration
from fgpose.trajectory import Convergence

# In 1/m^2: as strong as a prior of 30 cm, which is negligible for every joint that is determined.
_DAMPING_START = 10.0
_DAMPING_LEAST = 0.1
_DAMPING_MAX = 1e12
_DAMPING_GROWTH = 2.0
_DAMPING_MOST_DECREASE = 0.2
# Where the cost is curved by bones, the direction of a step is good but the whole step is too long. To try a part of it
# costs no factorisation.
_FRACTIONS = (0.5, 0.25)
# Except for the plain step, a step is taken only if the error falls by this share of the predicted decrease.
_SUFFICIENT = 0.25
_ROUNDING = 1e-12
_NOTHING = 1e-6  # of the tolerance: the length of a step below which rounding decides whether the error falls
# Within a shorter step, a limb of 25 cm bends by less than a hundredth of its standard deviation.
_CORRECTED_FROM_M = 0.005
# A correction that is longer than this share of its step cannot be relied on.
_MOST_CORRECTION = 0.5
# A step that is longer than this share of the one before is hardly shorter.
_CONTRACTION = 0.95
# A factorisation is replaced after such a step, or one that is longer than this.
_CHORD_REACH_M = 0.06

State = TypeVar("State")
Vector = Float[np.ndarray, " unknown"]


@runtime_checkable
class System(Protocol):
    """The factorised normal equations around a state, H + damping D."""

    def solve(self, right_hand_side: Vector) -> Vector:
        """Not finite where the equations do not determine a solution."""
        ...


@runtime_checkable
class Problem(Protocol[State]):
    """A non-linear least-squares problem.

    Robust kernels enter by reweighting, which keeps the normal equations positive semidefinite, so that a sufficiently
    damped step always descends. One with residuals that are far from linear within a step also has a method
    remainder(state, step), J^T (r(x + s) - r(x) - J s): the gradient of what a step changes beyond the linearisation.
    """

    @property
    def step_tolerance(self) -> float:
        """Converged when a step is smaller than this."""
        ...

    @property
    def damping_scale(self) -> Vector:
        """Diagonal of D: how a damping in 1/m^2 acts on unknowns of other units."""
        ...

    def error(self, state: State) -> float: ...

    def gradient(self, state: State) -> Vector: ...

    def factorized(self, state: State, damping: float) -> System | None:
        """None when the normal equations are not positive definite."""
        ...

    def moved(self, state: State, step: Vector) -> State: ...

    def step_size(self, step: Vector) -> float:
        """The largest move of any joint, metres (or of another unknown, as the problem defines it)."""
        ...


@dataclass(frozen=True)
class Solution(Generic[State]):
    """Where the optimiser ended, and how."""

    state: State
    convergence: Convergence


def levenberg_marquardt(problem: Problem[State], initial: State, max_iterations: int) -> Solution[State]:
    """Descend until a step with little or no damping is smaller than the problem's tolerance."""
    search = Search(problem, initial)
    initial_error = search.error
    for iteration in range(1, max_iterations + 1):
        size = search.descend()
        if size is None or size < problem.step_tolerance:
            return Solution(search.state, Convergence(size is not None, iteration, initial_error, search.error))
    return Solution(search.state, Convergence(False, max_iterations, initial_error, search.error))


class Search(Generic[State]):
    """The iteration, step by step."""

    def __init__(self, problem: Problem[State], initial: State) -> None:
        self._problem = problem
        self._remainder: Callable[[State, Vector], Vector] | None = getattr(problem, "remainder", None)
        self.state, self.error = initial, problem.error(initial)
        self._damping, self._growth = 0.0, _DAMPING_GROWTH
        self._system: System | None = None
        self._acceleration = AndersonAcceleration()
        self._last_size = np.inf
        self._before = self.error

    @property
    def undamped(self) -> System | None:
        """The latest factorisation, if it serves still and has no damping; that of a state near the present one."""
        return None if self._damping else self._system

    def descend(self) -> float | None:
        """Take one step that lowers the error.

        Returns:
            The size of the plain step; inf where damping shortens it, None when no damping helps.
        """
        gradient = self._problem.gradient(self.state)
        while self._damping <= _DAMPING_MAX:
            fresh = self._system is None
            self._system = self._system or self._problem.factorized(self.state, self._damping)
            if self._system is not None:
                step = -self._system.solve(gradient)
                size, decrease = self._problem.step_size(step), self._predicted_decrease(gradient, step)
                if self._take_whole(self._corrected(self._system, step, size), decrease):
                    self._prolong(step, size)
                    return self._settled(size, decrease if fresh else None)
                if self._is_nothing(size):
                    return size
                if fresh and self._take_part(gradient, step):
                    self._damp_more()
                    return np.inf
            if fresh:
                self._damp_more()
            else:
                self._forget()
        return None

    def _is_nothing(self, size: float) -> bool:
        """Whether the plain step is so short that rounding decides whether it lowers the error."""
        return not self._damping and size < _NOTHING * self._problem.step_tolerance

    def _corrected(self, system: System, step: Vector, size: float) -> Vector:
        """The step and what makes up for the remainder of the residuals, (H + damping D) c = -J^T remainder: a joint
        follows the circle around its neighbour, where the plain step leaves it along the tangent."""
        if self._remainder is None or not _CORRECTED_FROM_M < size < np.inf:
            return step
        correction = -system.solve(self._remainder(self.state, step))
        return step + correction if np.linalg.norm(correction) < _MOST_CORRECTION * np.linalg.norm(step) else step

    def _predicted_decrease(self, gradient: Vector, step: Vector) -> float:
        """-g s - s H s / 2, with (H + damping D) s = -g."""
        damped = self._damping and self._damping * np.dot(step, self._problem.damping_scale * step)
        return 0.5 * float(damped - np.dot(gradient, step))

    def _take_whole(self, step: Vector, predicted_decrease: float) -> bool:
        """Take the extrapolated step or, if that is not good enough, the plain one."""
        self._before = self.error
        extrapolated = self._acceleration.extrapolated(step)
        return (extrapolated is not None and self._take(step, extrapolated, _SUFFICIENT * predicted_decrease)) or (
            self._take(step, step, -_ROUNDING * self.error)
        )

    def _prolong(self, step: Vector, size: float) -> None:
        """Go on in the direction of a step that is hardly shorter than the last one, twice as far each time, while the
        error falls: away from a saddle, where a step is too short because the curvature is really negative."""
        if size < _CONTRACTION * self._last_size:
            return
        while True:
            step = 2 * step
            state = self._problem.moved(self.state, step)
            error = self._problem.error(state)
            if not error < self.error:
                return
            self.state, self.error = state, error
            self._acceleration.forget()

    def _take_part(self, gradient: Vector, step: Vector) -> bool:
        """Take a part of the step; the quadratic model predicts a decrease of f (1 - f / 2) of the slope."""
        slope = -float(np.dot(gradient, step))
        return any(self._take(step, f * step, _SUFFICIENT * f * (1 - f / 2) * slope) for f in _FRACTIONS)

    def _take(self, step: Vector, taken: Vector, least_decrease: float) -> bool:
        if not np.isfinite(taken).all():
            return False
        state = self._problem.moved(self.state, taken)
        error = self._problem.error(state)
        if not self.error - error >= least_decrease:
            return False
        self._acceleration.add(step, taken)
        self.state, self.error = state, error
        return True

    def _settled(self, size: float, predicted_decrease: float | None) -> float:
        """Choose the damping by the gain ratio, if the factorisation was fresh, and whether the factorisation is
        kept."""
        damping = self._damping
        if predicted_decrease and damping:
            gain = (self._before - self.error) / predicted_decrease
            decreased = damping * max(_DAMPING_MOST_DECREASE, 1 - (2 * gain - 1) ** 3)
            self._damping, self._growth = decreased if decreased >= _DAMPING_LEAST else 0.0, _DAMPING_GROWTH
        if self._damping != damping:
            self._forget()
        elif size > min(_CHORD_REACH_M, _CONTRACTION * self._last_size):
            self._system = None
        self._last_size = size
        return size if damping <= _DAMPING_START else np.inf

    def _damp_more(self) -> None:
        self._forget()
        self._damping = max(self._growth * self._damping, _DAMPING_START)
        self._growth *= _DAMPING_GROWTH

    def _forget(self) -> None:
        self._system = None
        self._acceleration.forget()
