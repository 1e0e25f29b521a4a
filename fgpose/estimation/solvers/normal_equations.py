"""One segment of a recording as normal equations in numpy: the same cost as the graph of solvers.gtsam_batch.

All factors of a kind are evaluated in one expression, and the frames are eliminated one after the other in LAPACK.
GTSAM treats every factor alone, which takes several times as long for a graph as regular as this one.

Every iteration factorises its own system. To use a factorisation again while the joints move little saves about a
tenth of the time to the same optimum, but the steps are then not those of Gauss-Newton: they become short before the
optimum is reached, and a criterion that looks at their length stops there.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from fgpose.estimation.factors.kinds import Factors, factors_of
from fgpose.estimation.factors.motion import Motions
from fgpose.estimation.factors.projection import detection_information
from fgpose.estimation.factors.state import BatchState, Information
from fgpose.estimation.segment import Segment
from fgpose.estimation.solvers.block_tridiagonal import BlockTridiagonal, Coupling


class NormalEquations:
    """The optimisation problem of a segment of frames (an optimizer.Problem).

    Joints that never take part are left out; the others are numbered by their slots. What takes no part in one of the
    frames is held at zero there.
    """

    def __init__(self, segment: Segment) -> None:
        self._segment = segment
        self._active = segment.active[:, segment.joints]
        self._factors: list[Factors] = factors_of(segment)
        # Only motion couples frames.
        motions = next(factors for factors in self._factors if isinstance(factors, Motions))
        self._coupling = Coupling(motions.coupling, np.repeat(motions.strength, 3, axis=1))
        n_frames, n_kinds, n_slots = len(segment.active), 1 + segment.with_velocity, len(segment.joints)
        # One array serves all iterations: it is by far the largest, and fresh memory costs as much as filling it.
        self._frames = np.empty((n_frames, n_kinds, n_slots, 3, n_kinds, n_slots, 3))

    def initial(self) -> BatchState:
        """The first guess; velocities start at zero, the solution does not depend on them."""
        segment = self._segment
        joints = np.zeros(self._frames.shape[:4])
        joints[:, 0][self._active] = segment.start_m[:, segment.joints][self._active]
        return BatchState(joints, np.nan_to_num(segment.lengths_m))

    def error(self, state: BatchState) -> float:
        return sum(factors.error(state) for factors in self._factors)

    def linearize(self, state: BatchState) -> _Linearized:
        return _Linearized(self, state)

    def gradient(self, state: BatchState) -> BatchState:
        gradient = BatchState(np.zeros_like(state.joints), np.zeros_like(state.lengths_m))
        for factors in self._factors:
            factors.add_gradient(gradient, state)
        return gradient

    def factorized(self, state: BatchState, damping: float) -> BlockTridiagonal:
        """The factorised information matrix around a state, damped. Takes the memory of the one before.

        Raises:
            numpy.linalg.LinAlgError: it is not positive definite.
        """
        information = Information(self._frames, len(state.lengths_m))
        for factors in self._factors:
            factors.add_information(information, state)
        size = int(np.prod(self._frames.shape[1:4]))
        diagonal = self._frames.reshape(-1, size, size)
        np.einsum("tii->ti", diagonal)[:] += damping
        np.einsum("ll->l", information.corner)[:] += damping
        return BlockTridiagonal(
            diagonal, self._coupling, information.border.reshape(len(diagonal), size, -1), information.corner
        )

    def moved(self, state: BatchState, step: BatchState, fraction: float) -> BatchState:
        return BatchState(state.joints + fraction * step.joints, state.lengths_m + fraction * step.lengths_m)

    def is_small(self, step: BatchState) -> bool:
        """Whether the joints move by less than the tolerance on average."""
        moves_m = np.linalg.norm(step.joints[:, 0][self._active], axis=-1)
        return not moves_m.size or bool(moves_m.mean() < self._segment.config.solver.step_tolerance_m)

    def positions_m(self, state: BatchState) -> Float[np.ndarray, "frame joint 3"]:
        """Positions of the active joints; NaN elsewhere."""
        return self._of_all_joints(state.joints[:, 0])

    def lengths_m(self, state: BatchState) -> Float[np.ndarray, " length"]:
        """Shared bone lengths; NaN where none is estimated."""
        lengths_m = np.full(state.lengths_m.shape, np.nan)
        lengths_m[self._segment.estimated_lengths] = state.lengths_m[self._segment.estimated_lengths]
        return lengths_m

    def covariance_m2(self, positions_m: Float[np.ndarray, "frame joint 3"]) -> Float[np.ndarray, "frame joint 3 3"]:
        """Marginal covariance of every active joint's position around these; NaN elsewhere.

        Raises:
            ValueError: a joint is not held by any factor.
        """
        state = self.initial()
        state.joints[:, 0] = np.nan_to_num(positions_m[:, self._segment.joints])
        try:
            blocks = self.factorized(state, damping=0.0).inverse_blocks()
        except np.linalg.LinAlgError as error:
            raise ValueError(f"a joint is not held by any factor: {error}") from None
        return self._of_all_joints(np.einsum("tjajb->tjab", blocks.reshape(self._frames.shape)[:, 0, :, :, 0]))

    def frame_information(
        self, positions_m: Float[np.ndarray, "frame joint 3"]
    ) -> Float[np.ndarray, "frame joint 3 3"]:
        """Information of the detections of each frame alone on every active joint, 1/m^2; NaN elsewhere."""
        segment, evidence = self._segment, self._segment.evidence
        points_m = np.where(segment.active[..., None], positions_m, np.nan)
        return detection_information(
            segment.rig, evidence.undistorted_px, evidence.weights, points_m, segment.config.projection
        )

    def _of_all_joints(self, of_slots: np.ndarray) -> np.ndarray:
        segment = self._segment
        of_joints = np.full((*segment.active.shape, *of_slots.shape[2:]), np.nan)
        of_joints[:, segment.joints] = of_slots
        of_joints[~segment.active] = np.nan
        return of_joints


@dataclass(frozen=True, eq=False)
class _Linearized:
    """Gauss-Newton's system around a state."""

    equations: NormalEquations
    state: BatchState

    @cached_property
    def _gradient(self) -> BatchState:
        return self.equations.gradient(self.state)

    def predicted_decrease(self, step: BatchState, damping: float, fraction: float) -> float:
        """With (H + damping) s = -g, the curvature s H s is -g s - damping s s; there is no need of H."""
        slope = _dot(self._gradient, step)
        curvature = -slope - damping * _dot(step, step)
        return -(fraction * slope + fraction**2 / 2 * curvature)

    def solve(self, damping: float) -> BatchState | None:
        gradient = self._gradient
        try:
            factorized = self.equations.factorized(self.state, damping)
        except np.linalg.LinAlgError:
            return None
        joints, lengths_m = factorized.solve(gradient.joints.reshape(len(gradient.joints), -1), gradient.lengths_m)
        if not np.isfinite(joints).all() or not np.isfinite(lengths_m).all():
            return None
        return BatchState(-joints.reshape(gradient.joints.shape), -lengths_m)


def _dot(one: BatchState, other: BatchState) -> float:
    return float(np.vdot(one.joints, other.joints) + np.vdot(one.lengths_m, other.lengths_m))
