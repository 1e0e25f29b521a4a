"""One segment of a recording as one GTSAM factor graph: build, linearise, read back."""

from __future__ import annotations

import gtsam
import numpy as np
from jaxtyping import Float

from fgpose.estimation.factors.bone_length import SharedLengths
from fgpose.estimation.factors.kinds import factors_of
from fgpose.estimation.factors.state import BatchState
from fgpose.estimation.keys import length_key
from fgpose.estimation.segment import Segment
from fgpose.estimation.solvers.gtsam_problem import GraphProblem
from fgpose.estimation.solvers.normal_equations import DAMPING_TIME_S


class GtsamBatch(GraphProblem):
    """The optimisation problem of a segment of frames.

    The shared bone lengths would be Python callbacks in the graph, which would take three times as long: they are
    linearised in one expression and stand beside the graph.
    """

    def __init__(self, segment: Segment) -> None:
        super().__init__(gtsam.NonlinearFactorGraph(), segment.config.solver.step_tolerance_m)
        self._segment, self._active = segment, segment.active[:, segment.joints]
        self._bones: list[tuple[SharedLengths, list[list[int]]]] = []
        for factors in factors_of(segment):
            if isinstance(factors, SharedLengths):
                self._bones.append((factors, factors.joined_keys(segment.keys)))
                continue
            for factor in factors.graph_factors(segment.keys):
                self.graph.add(factor)

    def initial(self) -> gtsam.Values:
        """The first guess as Values; velocities start at zero, the solution does not depend on them."""
        values, segment = gtsam.Values(), self._segment
        zero, start_m = np.zeros(3), segment.start_m[:, segment.joints]
        for frame, slot in np.argwhere(self._active).tolist():
            values.insert(segment.keys.position(frame, slot), start_m[frame, slot])
            if segment.with_velocity:
                values.insert(segment.keys.velocity(frame, slot), zero)
        for length in segment.estimated_lengths.tolist():
            values.insert(length_key(length), float(segment.lengths_m[length]))
        return values

    def error(self, state: gtsam.Values) -> float:
        error = super().error(state)
        if not self._bones:
            return error
        arrays = self._as_arrays(state)
        return error + sum(factors.error(arrays) for factors, _ in self._bones)

    def gaussian(self, state: gtsam.Values) -> gtsam.GaussianFactorGraph:
        linear = super().gaussian(state)
        if self._bones:
            arrays = self._as_arrays(state)
            for factors, keys in self._bones:
                for factor in factors.linear_factors(keys, arrays):
                    linear.add(factor)
        return linear

    @property
    def damping_scale(self) -> Float[np.ndarray, " unknown"]:
        """As NormalEquations has it. Keys sort by symbol: lengths, velocities, positions."""
        n_points = 3 * int(self._active.sum())
        counts = len(self._segment.estimated_lengths), n_points * self._segment.with_velocity, n_points
        return np.repeat([float(len(self._active)), DAMPING_TIME_S**2, 1.0], counts)

    def moves_m(self, step: Float[np.ndarray, " unknown"]) -> Float[np.ndarray, "variable 3"]:
        return step[len(step) - 3 * int(self._active.sum()) :].reshape(-1, 3)

    def positions_m(self, state: gtsam.Values) -> Float[np.ndarray, "frame joint 3"]:
        """Positions of the active joints; NaN elsewhere."""
        positions_m = np.full((*self._segment.active.shape, 3), np.nan)
        positions_m[self._segment.active] = self._active_positions(state)
        return positions_m

    def lengths_m(self, state: gtsam.Values) -> Float[np.ndarray, " length"]:
        """Shared bone lengths; NaN where none is estimated."""
        lengths_m = np.full(self._segment.lengths_m.shape, np.nan)
        for length in self._segment.estimated_lengths.tolist():
            lengths_m[length] = state.atDouble(length_key(length))
        return lengths_m

    def _active_positions(self, values: gtsam.Values) -> Float[np.ndarray, "variable 3"]:
        # Keys sort by symbol: velocities come before positions.
        points = gtsam.utilities.extractPoint3(values)
        return points[len(points) - int(self._active.sum()) :]

    def _as_arrays(self, values: gtsam.Values) -> BatchState:
        """Positions and lengths as the factors take them in numpy; no velocities."""
        joints = np.zeros((len(self._active), 1, self._active.shape[1], 3))
        joints[:, 0][self._active] = self._active_positions(values)
        return BatchState(joints, self.lengths_m(values))
