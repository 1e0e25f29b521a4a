"""The optimum of a segment, by the backend that the configuration names."""

from __future__ import annotations

from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from fgpose.estimation.segment import Segment
from fgpose.estimation.solvers.gtsam_batch import GtsamBatch
from fgpose.estimation.solvers.levenberg_marquardt import Problem, State, levenberg_marquardt
from fgpose.estimation.solvers.normal_equations import NormalEquations
from fgpose.trajectory import Convergence


@runtime_checkable
class _SegmentProblem(Problem[State], Protocol):
    """What NormalEquations and GtsamBatch have in common."""

    def initial(self) -> State: ...

    def positions_m(self, state: State) -> Float[np.ndarray, "frame joint 3"]: ...

    def lengths_m(self, state: State) -> Float[np.ndarray, " length"]: ...


class Optimum(NamedTuple):
    """Where the optimiser ended."""

    positions_m: Float[np.ndarray, "frame joint 3"]
    """NaN where a joint is not estimated."""
    lengths_m: Float[np.ndarray, " length"]
    convergence: Convergence


def optimum(segment: Segment) -> Optimum:
    """Of all factors of a segment in which some joint is estimated, from its first guess."""
    if segment.config.solver.backend == "gtsam":
        return _minimized(GtsamBatch(segment), segment)
    return _minimized(NormalEquations(segment), segment)


def _minimized(problem: _SegmentProblem[State], segment: Segment) -> Optimum:
    solution = levenberg_marquardt(problem, problem.initial(), segment.config.solver.max_iterations)
    return Optimum(problem.positions_m(solution.state), problem.lengths_m(solution.state), solution.convergence)
