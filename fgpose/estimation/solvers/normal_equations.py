"""The numpy backend: a segment of a recording as normal equations, with the same cost as the graph of gtsam_batch.

All factors of a kind are evaluated in one expression, and LAPACK eliminates all frames in one call. GTSAM treats
every factor separately, which takes several times as long for a graph as regular as this one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
from jaxtyping import Float, Int

from fgpose.estimation.factors.bone_length import SharedLengths
from fgpose.estimation.factors.joint_rows import JointRows
from fgpose.estimation.factors.kinds import Cost, factors_of
from fgpose.estimation.factors.marginal import Marginals
from fgpose.estimation.factors.motion import Motions
from fgpose.estimation.factors.projection import Projections
from fgpose.estimation.factors.state import BatchState, Information
from fgpose.estimation.segment import LinkageBlocks, Segment, position_blocks
from fgpose.estimation.solvers.block_tridiagonal import Band, BlockTridiagonal
from fgpose.geometry.vectors import norm

# Damping as strong as a prior of 1 m on a position is as strong as one of 10 m/s on a velocity.
DAMPING_TIME_S = 0.1
# Of positions, metres^-2, for problems that double precision cannot tell from undetermined ones; none as a rule.
_PRIORS = (0.0, 1e-6, 1e-3, 1.0, 1e3, 1e6, 1e9)


Determined = TypeVar("Determined")


class NormalEquations:
    """The optimisation problem of a segment of frames (a levenberg_marquardt.Problem).

    Joints that are estimated in no frame are left out; the others are numbered by their slots. In frames where a joint
    is not estimated, its unknowns are held at zero.
    """

    def __init__(self, segment: Segment) -> None:
        self._segment = segment
        self._active = segment.active[:, segment.joints]
        self._factors: list[Cost] = [*factors_of(segment), *Marginals.of(segment)]
        # Only motion couples frames.
        self.motions = next(factors for factors in self._factors if isinstance(factors, Motions))
        self.linkages = segment.linkages
        strength = (np.repeat(self.motions.strength[:, slots], 3, axis=1) for slots in self.linkages)
        self._couplings = [each[..., None, None] * self.motions.coupling[:, None] for each in strength]
        n_frames, n_kinds, n_slots = len(segment.active), 1 + segment.with_velocity, len(segment.joints)
        # One array serves all iterations: it is by far the largest, and fresh memory costs as much as filling it.
        self._band = Band(n_frames, [3 * len(slots) for slots in self.linkages], n_kinds)
        self._shape = n_frames, n_kinds, n_slots, 3
        self._order = Order.of(self._shape, self.linkages)
        self.step_tolerance = segment.config.solver.step_tolerance_m

    def initial(self) -> BatchState:
        """The first guess; velocities start at zero, the solution does not depend on them."""
        segment = self._segment
        joints = np.zeros(self._shape)
        joints[:, 0][self._active] = segment.start_m[:, segment.joints][self._active]
        return BatchState(joints, self._first_lengths_m)

    def at(self, poses: Float[np.ndarray, "frame kind joint 3"]) -> BatchState:
        """The state with these positions and velocities, finite where a joint is active, and the first guess of the
        lengths."""
        active = self._active[:, None, :, None]
        return BatchState(np.where(active, poses[:, :, self._segment.joints], 0.0), self._first_lengths_m)

    def error(self, state: BatchState) -> float:
        return sum(factors.error(state) for factors in self._factors)

    @property
    def _first_lengths_m(self) -> Float[np.ndarray, " length"]:
        return np.nan_to_num(self._segment.lengths_m[: self._segment.n_lengths])

    @cached_property
    def damping_scale(self) -> Float[np.ndarray, " unknown"]:
        """1 for positions, squared seconds for velocities, the number of frames for lengths: they move joints in all
        frames."""
        joints = np.ones(self._shape)
        joints[:, 1:] = DAMPING_TIME_S**2
        return np.append(joints, np.full(self._segment.n_lengths, float(len(joints))))

    def gradient(self, state: BatchState) -> Float[np.ndarray, " unknown"]:
        gradient = self._gradient(state)
        return np.append(gradient.joints, gradient.lengths_m)

    def joint_gradient(self, state: BatchState) -> Float[np.ndarray, "frame kind slot 3"]:
        """The joints' part of it."""
        return self._gradient(state).joints

    def _gradient(self, state: BatchState) -> BatchState:
        gradient = BatchState(np.zeros_like(state.joints), np.zeros_like(state.lengths_m))
        for factors in self._factors:
            factors.add_gradient(gradient, state)
        return gradient

    def remainder(self, state: BatchState, step: Float[np.ndarray, " unknown"]) -> Float[np.ndarray, " unknown"]:
        """Of the bones: all other residuals are close to linear over a step."""
        gradient = BatchState(np.zeros_like(state.joints), np.zeros_like(state.lengths_m))
        by_state = BatchState(*_split(step, self._shape))
        for factors in self._factors:
            if isinstance(factors, JointRows):
                factors.add_remainder(gradient, state, by_state)
        return np.append(gradient.joints, gradient.lengths_m)

    def factorized(self, state: BatchState, damping: float) -> Factorized | None:
        """The information matrix, with the curvature of bones under tension and damping; None if not positive definite.

        The factorisation of the state before is overwritten.
        """
        information = self._information(state, with_tension=True)
        try:
            return Factorized(self._factorize(information, damping), self._order)
        except np.linalg.LinAlgError:
            return None

    def _information(self, state: BatchState, *, with_tension: bool = False) -> Information:
        self._band.columns[:] = 0.0
        n_frames, n_kinds, _, _ = self._shape
        frames = [
            self._band.diagonal(number).reshape(n_frames, *2 * (len(slots), 3, n_kinds))
            for number, slots in enumerate(self.linkages)
        ]
        information = Information(self.linkages, frames, len(state.lengths_m))
        for factors in self._factors:
            factors.add_information(information, state)
            if with_tension and isinstance(factors, SharedLengths):
                factors.add_tension(information, state)
        return information

    def _factorize(self, information: Information, damping: float = 0.0) -> BlockTridiagonal:
        """Raises numpy.linalg.LinAlgError: not positive definite."""
        if damping:
            joints, lengths = _split(damping * self.damping_scale, self._shape)
            information.single_unknowns[:] += joints
            np.einsum("ll->l", information.corner)[:] += lengths
        information.spread()
        border = self._order.ordered(information.border.transpose(0, 3, 1, 2, 4))
        return BlockTridiagonal(self._band, self._couplings, border, information.corner)

    def moved(self, state: BatchState, step: Float[np.ndarray, " unknown"]) -> BatchState:
        joints, lengths_m = _split(step, self._shape)
        return BatchState(state.joints + joints, state.lengths_m + lengths_m)

    def step_size(self, step: Float[np.ndarray, " unknown"]) -> float:
        moves_m = norm(_split(step, self._shape)[0][:, 0][self._active])
        return float(moves_m.max(initial=0.0))

    def positions_m(self, state: BatchState) -> Float[np.ndarray, "frame joint 3"]:
        """Positions of the active joints; NaN elsewhere."""
        return _of_all_joints(state.joints[:, 0], self._segment)

    def poses(self, state: BatchState) -> Float[np.ndarray, "frame kind joint 3"]:
        """Positions and velocities of the active joints; zero elsewhere."""
        return self.of_joints(np.where(self._active[:, None, :, None], state.joints, 0.0))

    def of_joints(self, of_slots: Float[np.ndarray, "*kinds slot 3"]) -> Float[np.ndarray, "*kinds joint 3"]:
        """Zero for joints that are estimated in no frame."""
        of_joints = np.zeros((*of_slots.shape[:-2], self._segment.skeleton.n_joints, 3))
        of_joints[..., self._segment.joints, :] = of_slots
        return of_joints

    def lengths_m(self, state: BatchState) -> Float[np.ndarray, " length"]:
        """Shared bone lengths; NaN where none is estimated."""
        lengths_m = np.full(self._segment.skeleton.n_lengths, np.nan)
        lengths_m[self._segment.estimated_lengths] = state.lengths_m[self._segment.estimated_lengths]
        return lengths_m

    def matrix(self, state: BatchState, near: Factorized | None = None) -> BlockTridiagonal:
        """Factorised, with a prior where there must be one (see linearized), and raises as it does.

        Args:
            state: around which.
            near: the latest factorisation of this problem, if it was around a state near this one.
        """
        if near is not None:
            return near.matrix
        return _with_least_prior(lambda damping: self._factorize(self._information(state), damping))

    def covariances(self, matrix: BlockTridiagonal) -> Iterator[LinkageBlocks]:
        """Marginal covariance of the unknowns of all joints in each frame, from the last frame to the first; those of
        joints that are not estimated do not count."""
        return map(self.of_all_joints, matrix.inverse_blocks())

    def of_all_joints(self, of_slots: Sequence[Float[np.ndarray, "_ _"]]) -> LinkageBlocks:
        """Matrices of the unknowns of each linkage in a frame, with those of joints that are estimated in none."""
        linkages, per_joint, blocks = self._segment.skeleton.linkages, 3 * self._shape[1], []
        for joints, slots, block in zip(linkages, self.linkages, of_slots, strict=True):
            if len(slots) < len(joints):
                there = np.repeat(np.isin(joints, self._segment.joints), per_joint)
                own, block = block, np.zeros((there.size, there.size))
                block[np.ix_(there, there)] = own
            blocks.append(block)
        return LinkageBlocks(linkages, tuple(blocks))

    def linearized(self, positions_m: Float[np.ndarray, "frame joint 3"]) -> Linearized:
        """The problem around these positions of the active joints. Overwrites the factorisation of the state before.

        Where one quantity is known 1e8 times better than another it is not positive definite in double precision: then
        with the least of some priors that make it so.

        Raises:
            numpy.linalg.LinAlgError: none of them does.
        """
        state = self.initial()
        state.joints[:, 0] = np.nan_to_num(positions_m[:, self._segment.joints])
        matrix = self.matrix(state)
        projections = next(factors for factors in self._factors if isinstance(factors, Projections))
        detections = projections.whitened(state.joints[:, 0])
        return Linearized(Factorized(matrix, self._order), self._segment, *detections)


@dataclass(frozen=True, eq=False)
class Order:
    """Of the joints' unknowns in a matrix: by linkage, frame, joint, axis, kind."""

    shape: tuple[int, ...]
    """frame, kind, slot, 3: of the unknowns as arrays."""
    numbers: Int[np.ndarray, " unknown"]
    """Of the unknowns in such an array, as they come in the matrix."""

    @staticmethod
    def of(shape: tuple[int, ...], linkages: Sequence[Int[np.ndarray, " _"]]) -> Order:
        numbers = np.arange(math.prod(shape)).reshape(shape).transpose(0, 2, 3, 1)
        return Order(shape, np.concatenate([numbers[:, slots].ravel() for slots in linkages]))

    def ordered(self, values: Float[np.ndarray, "frame kind slot 3 *columns"]) -> np.ndarray:
        """One after the other, as they come in the matrix."""
        return values.reshape(self.numbers.size, *values.shape[4:])[self.numbers]

    def back(self, ordered: np.ndarray) -> Float[np.ndarray, "frame kind slot 3 *columns"]:
        """The inverse of ordered."""
        values = np.empty_like(ordered)
        values[self.numbers] = ordered
        return values.reshape(*self.shape, *ordered.shape[1:])


@dataclass(frozen=True, eq=False)
class Factorized:
    """Normal equations that can be solved."""

    matrix: BlockTridiagonal
    order: Order

    def solve(self, right_hand_side: Float[np.ndarray, " unknown"]) -> Float[np.ndarray, " unknown"]:
        joints, lengths = _split(right_hand_side, self.order.shape)
        solved, solved_lengths = self.matrix.solve(self.order.ordered(joints), lengths)
        return np.append(self.order.back(solved), solved_lengths)


@dataclass(frozen=True, eq=False)
class Linearized:
    """A problem around a solution, from which joints deviate as the errors of detections want it. All detections are in
    their standard deviations; without one, everything is zero."""

    _factorized: Factorized
    _segment: Segment
    residual: Float[np.ndarray, "frame camera slot 2"]
    jacobian: Float[np.ndarray, "frame camera slot 2 3"]
    """By the position of the joint, 1/m."""
    weight: Float[np.ndarray, "frame camera slot"]
    """Of the robust kernel."""

    @cached_property
    def _pull(self) -> Float[np.ndarray, "frame slot 3 view"]:
        """Of the errors on the joints; a view is one axis of the image of one camera."""
        weighted = (self.weight[..., None, None] * self.jacobian).transpose(0, 2, 4, 1, 3)
        return weighted.reshape(*weighted.shape[:3], -1)

    def covariance_m2(self) -> Float[np.ndarray, "frame joint 3 3"]:
        """Marginal covariance of every active joint's position, all errors taken for independent; NaN elsewhere."""
        n_frames, _, n_slots, _ = self._factorized.order.shape
        covariance_m2 = np.empty((n_frames, n_slots, 3, 3))
        all_blocks = self._factorized.matrix.inverse_blocks()
        for t, blocks in zip(reversed(range(n_frames)), all_blocks, strict=True):
            for slots, block in zip(self._segment.linkages, blocks, strict=True):
                covariance_m2[t, slots] = position_blocks(block, len(slots))
        return _of_all_joints(covariance_m2, self._segment)

    def deviation_m(self, errors: Float[np.ndarray, "frame camera slot 2"]) -> Float[np.ndarray, "frame slot 3"]:
        """Of the joints' positions, if these are the errors of the detections."""
        gradient = np.zeros(self._factorized.order.shape)
        gradient[:, 0] = (self._pull @ errors.swapaxes(1, 2).reshape(*self._pull.shape[:2], -1, 1))[..., 0]
        no_lengths = np.zeros(self._segment.n_lengths)
        solved = self._factorized.solve(np.append(gradient, no_lengths))
        return _split(solved, self._factorized.order.shape)[0][:, 0]

    def length_effects_m(self) -> Float[np.ndarray, "frame camera slot 2 length"]:
        """Deviations of the shared bone lengths, by the error of each detection: what deviation_m is of the joints."""
        order, n_lengths = self._factorized.order, self._segment.n_lengths
        n_frames, _, n_slots, _ = order.shape
        responses = order.back(self._factorized.matrix.shared_responses())
        effects_m = self._pull.swapaxes(-1, -2) @ responses[:, 0]
        return effects_m.reshape(n_frames, n_slots, effects_m.shape[2] // 2, 2, n_lengths).transpose(0, 2, 1, 3, 4)

    def length_covariance_m2(self) -> Float[np.ndarray, "length length"]:
        """Covariance of the shared bone lengths, all errors taken for independent."""
        return self._factorized.matrix.shared_covariance


def _with_least_prior(determine: Callable[[float], Determined]) -> Determined:
    """What is determined with the first prior that makes it so. Raises numpy.linalg.LinAlgError if none does."""
    for damping in _PRIORS[:-1]:
        try:
            return determine(damping)
        except np.linalg.LinAlgError:
            continue
    return determine(_PRIORS[-1])


def _of_all_joints(of_slots: np.ndarray, segment: Segment) -> np.ndarray:
    """NaN where a joint is not estimated."""
    of_joints = np.full((*segment.active.shape, *of_slots.shape[2:]), np.nan)
    of_joints[:, segment.joints] = of_slots
    of_joints[~segment.active] = np.nan
    return of_joints


def _split(vector: Float[np.ndarray, " unknown"], shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """The parts of a vector of all unknowns: of the joints, in this shape (frame kind joint 3), and of the lengths."""
    size = math.prod(shape)
    return vector[:size].reshape(shape), vector[size:]
