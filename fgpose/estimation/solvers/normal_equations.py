"""One segment of a recording as normal equations in numpy: the same cost as the graph of solvers.gtsam_batch.

All factors of a kind are evaluated in one expression, and the frames are eliminated one after the other in LAPACK.
GTSAM treats every factor alone, which takes several times as long for a graph as regular as this one.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from fgpose.config import ProjectionConfig
from fgpose.estimation import frame_factors
from fgpose.estimation.segment import Segment
from fgpose.estimation.solvers.block_tridiagonal import BlockTridiagonal, Coupling
from fgpose.estimation.solvers.terms import (
    BatchState,
    Fading,
    FrameSymmetry,
    Information,
    Motion,
    PointPriors,
    Priors,
    Projections,
    SharedLengths,
    Term,
)
from fgpose.geometry.camera import CameraRig
from fgpose_factors import depth_covariance_m2

# The steps that an information matrix leads to are right only near the state that it belongs to, but the gradient is
# always that of the state itself: so near, they lead to the same place in hardly more iterations.
_NEAR_M = 4e-3


class NormalEquations:
    """The optimisation problem of a segment of frames (an optimizer.Problem).

    Joints that never take part are left out; the others are numbered by their slots. What takes no part in one of the
    frames is held at zero there.
    """

    def __init__(self, segment: Segment) -> None:
        self._stretch = segment
        self._active = segment.active[:, segment.joints]
        motion = _motion(segment)
        self._terms: list[Term] = [
            motion,
            *projections(segment.rig, *self._detections(), segment.config.projection),
            *_fading(segment),
            *_anchors(segment),
            *_depths(segment),
            *_symmetry(segment),
            _priors(segment),
        ]
        self._coupling = Coupling(motion.coupling, np.repeat(motion.strength, 3, axis=1))
        n_frames, n_kinds, n_slots = len(segment.active), 1 + segment.with_velocity, len(segment.joints)
        # One array serves all iterations: it is by far the largest, and fresh memory costs as much as filling it.
        self._frames = np.empty((n_frames, n_kinds, n_slots, 3, n_kinds, n_slots, 3))
        self._factorized: BlockTridiagonal | None = None
        self._factorized_at = self.initial()

    def initial(self) -> BatchState:
        """The first guess; velocities start at zero, the solution does not depend on them."""
        segment = self._stretch
        joints = np.zeros(self._frames.shape[:4])
        joints[:, 0][self._active] = segment.evidence.guess_m[:, segment.joints][self._active]
        return BatchState(joints, np.nan_to_num(segment.lengths_m))

    def error(self, state: BatchState) -> float:
        return sum(term.error(state) for term in self._terms)

    def linearize(self, state: BatchState) -> _Linearized:
        return _Linearized(self, state)

    def gradient(self, state: BatchState) -> BatchState:
        gradient = BatchState(np.zeros_like(state.joints), np.zeros_like(state.lengths_m))
        for term in self._terms:
            term.add_gradient(gradient, state)
        return gradient

    def factorized(self, state: BatchState, damping: float) -> BlockTridiagonal:
        """The factorised information matrix around a state, damped. That of a nearby state serves again.

        Raises:
            numpy.linalg.LinAlgError: it is not positive definite.
        """
        if damping or self._factorized is None or self._mean_move_m(_difference(state, self._factorized_at)) > _NEAR_M:
            self._factorized = None  # its memory is used again
            factorized = self._factorize(state, damping)
            if damping:
                return factorized
            self._factorized, self._factorized_at = factorized, state
        return self._factorized

    def _factorize(self, state: BatchState, damping: float = 0.0) -> BlockTridiagonal:
        information = Information(self._frames, len(state.lengths_m))
        for term in self._terms:
            term.add_information(information, state)
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
        return self._mean_move_m(step) < self._stretch.config.solver.step_tolerance_m

    def _mean_move_m(self, step: BatchState) -> float:
        moves_m = np.linalg.norm(step.joints[:, 0][self._active], axis=-1)
        return float(moves_m.mean()) if moves_m.size else 0.0

    def positions_m(self, state: BatchState) -> Float[np.ndarray, "frame joint 3"]:
        """Positions of the active joints; NaN elsewhere."""
        return self._of_all_joints(state.joints[:, 0])

    def lengths_m(self, state: BatchState) -> Float[np.ndarray, " length"]:
        """Shared bone lengths; NaN where none takes part."""
        segment = self._stretch
        used = [length for *_, length in segment.bones_with_length()]
        lengths_m = np.full(state.lengths_m.shape, np.nan)
        lengths_m[used] = state.lengths_m[used]
        return lengths_m

    def covariance_m2(self, positions_m: Float[np.ndarray, "frame joint 3"]) -> Float[np.ndarray, "frame joint 3 3"]:
        """Marginal covariance of every active joint's position around these; NaN elsewhere.

        Raises:
            ValueError: a joint is not held by any term.
        """
        state = self.initial()
        state.joints[:, 0] = np.nan_to_num(positions_m[:, self._stretch.joints])
        self._factorized = None
        try:
            blocks = self._factorize(state).inverse_blocks()
        except np.linalg.LinAlgError as error:
            raise ValueError(f"a joint is not held by any factor: {error}") from None
        return self._of_all_joints(np.einsum("tjajb->tjab", blocks.reshape(self._frames.shape)[:, 0, :, :, 0]))

    def frame_information(
        self, positions_m: Float[np.ndarray, "frame joint 3"]
    ) -> Float[np.ndarray, "frame joint 3 3"]:
        """Information of the detections of each frame alone on every active joint, 1/m^2; NaN elsewhere."""
        state = self.initial()
        state.joints[:, 0] = np.nan_to_num(positions_m[:, self._stretch.joints])
        of_slots = sum(term.information(state) for term in self._terms if isinstance(term, Projections))
        return self._of_all_joints(np.asarray(of_slots))

    def _detections(self) -> tuple[Float[np.ndarray, "frame camera slot 2"], Float[np.ndarray, "frame camera slot"]]:
        """Where they are, NaN for joints that take no part, and their weights."""
        evidence, joints = self._stretch.evidence, self._stretch.joints
        used = self._active[:, None, :, None]
        return np.where(used, evidence.undistorted_px[:, :, joints], np.nan), evidence.weights[:, :, joints]

    def _of_all_joints(self, of_slots: np.ndarray) -> np.ndarray:
        segment = self._stretch
        of_joints = np.full((*segment.active.shape, *of_slots.shape[2:]), np.nan)
        of_joints[:, segment.joints] = of_slots
        of_joints[~segment.active] = np.nan
        return of_joints


def _difference(state: BatchState, other: BatchState) -> BatchState:
    return BatchState(state.joints - other.joints, state.lengths_m - other.lengths_m)


@dataclass(frozen=True, eq=False)
class _Linearized:
    """Gauss-Newton's system around a state."""

    chain: NormalEquations
    state: BatchState

    @cached_property
    def _gradient(self) -> BatchState:
        return self.chain.gradient(self.state)

    def foreseen_decrease(self, step: BatchState, fraction: float) -> float:
        """Without damping H s = -g, so that g s + s H s / 2 is half of g s."""
        slope = np.vdot(self._gradient.joints, step.joints) + np.vdot(self._gradient.lengths_m, step.lengths_m)
        return -float(slope) * fraction * (1 - fraction / 2)

    def solve(self, damping: float) -> BatchState | None:
        gradient = self._gradient
        try:
            factorized = self.chain.factorized(self.state, damping)
        except np.linalg.LinAlgError:
            return None
        joints, lengths_m = factorized.solve(gradient.joints.reshape(len(gradient.joints), -1), gradient.lengths_m)
        if not np.isfinite(joints).all() or not np.isfinite(lengths_m).all():
            return None
        return BatchState(-joints.reshape(gradient.joints.shape), -lengths_m)


def projections(
    rig: CameraRig,
    undistorted_px: Float[np.ndarray, "frame camera joint 2"],
    weights: Float[np.ndarray, "frame camera joint"],
    config: ProjectionConfig,
) -> Iterator[Projections]:
    """One term per camera."""
    precision = np.where(
        np.isnan(undistorted_px).any(axis=-1), 0.0, frame_factors.projection_sigma_px(weights, config) ** -2
    )
    for number, camera in enumerate(rig.cameras):
        measured_px = np.nan_to_num(undistorted_px[:, number])
        yield Projections(camera, measured_px, precision[:, number], config.kernel, config.kernel_scale)


def _motion(segment: Segment) -> Motion:
    config = segment.config.motion
    strength = (segment.kept / segment.process_density)[1:, segment.joints]
    step_s = np.maximum(np.diff(segment.evidence.time_s), frame_factors.shortest_step_s(config))
    one, zero = np.ones_like(step_s), np.zeros_like(step_s)
    if config.model != "constant_velocity":
        return Motion(strength, one[:, None, None], 1 / step_s[:, None, None])
    transition = np.array([[one, step_s], [zero, one]])
    across = -6 / step_s**2
    precision = np.array([[12 / step_s**3, across], [across, 4 / step_s]])
    return Motion(strength, transition.transpose(2, 0, 1), precision.transpose(2, 0, 1))


def _slots(segment: Segment) -> Int[np.ndarray, " joint"]:
    slots = np.full(segment.skeleton.n_joints, -1)
    slots[segment.joints] = np.arange(len(segment.joints))
    return slots


def _fading(segment: Segment) -> Iterator[Fading]:
    config, active = segment.config.motion, segment.active
    unseen = active & ~segment.evidence.seen
    unseen[:1] = False
    if config.model != "constant_velocity" or not unseen.any():
        return
    frame, joint = np.nonzero(unseen)
    holders = [
        frame_factors.holder(segment.skeleton, j, active[f], segment.evidence.seen[f])
        for f, j in np.argwhere(unseen).tolist()
    ]
    reference = np.array([-1 if holder is None else _slots(segment)[holder] for holder in holders])
    step_s = np.diff(segment.evidence.time_s)[frame - 1]
    precision = step_s / (config.fade_s**2 * segment.process_density[frame, joint])
    yield Fading(frame, _slots(segment)[joint], reference, precision)


def _anchors(segment: Segment) -> Iterator[PointPriors]:
    evidence, joints = segment.evidence, segment.joints
    anchored = (segment.active & evidence.anchored)[:, joints]
    if anchored.any():
        positions_m = np.where(anchored[..., None], evidence.guess_m[:, joints], 0.0)
        information = anchored[..., None, None] * np.eye(3) / segment.config.fusion.anchor_sigma_m**2
        yield PointPriors(positions_m, information, frame_factors.ANCHOR_KERNEL, frame_factors.ANCHOR_KERNEL_SCALE)


def _depths(segment: Segment) -> Iterator[PointPriors]:
    evidence, joints, config = segment.evidence, segment.joints, segment.config.depth
    spread = frame_factors.depth_spread(np.diff(evidence.time_s, prepend=-np.inf), config)
    for view in range(evidence.views_m.shape[1]):
        sigma_m = spread[:, None] * evidence.depth_sigma_m[:, view, joints]
        used = np.isfinite(sigma_m) & segment.active[:, joints]
        information = np.zeros((*used.shape, 3, 3))
        covariance_m2 = depth_covariance_m2(evidence.rays[:, view, joints][used], sigma_m[used])
        information[used] = np.linalg.inv(covariance_m2)
        positions_m = np.where(used[..., None], evidence.views_m[:, view, joints], 0.0)
        if used.any():
            yield PointPriors(positions_m, information, config.kernel, config.kernel_scale)


def _symmetry(segment: Segment) -> Iterator[SharedLengths | FrameSymmetry]:
    config, slot_of = segment.config.symmetry, _slots(segment)
    if config.form == "shared_length":
        bones = list(segment.bones_with_length())
        if bones:
            start, end, length = np.array(bones).T
            present = np.stack([segment.present(a, b) for a, b, _ in bones], axis=1)
            yield SharedLengths(slot_of[start], slot_of[end], length, present, config.sigma_m)
    elif config.form == "frame":
        pairs = [(*left, *right) for left, right in segment.skeleton.limb_pairs]
        if not pairs:
            return
        present = np.stack([segment.present(*pair) for pair in pairs], axis=1)
        used = present.any(axis=0)
        if used.any():
            yield FrameSymmetry(slot_of[np.array(pairs)[used]].T, present[:, used], config.sigma_m)


def _priors(segment: Segment) -> Priors:
    """Those of the graph; besides, what takes no part is held at zero, so that every unknown is determined."""
    config, active = segment.config.prior, segment.active[:, segment.joints]
    entering = active & ~segment.kept[:, segment.joints]
    sigmas = (config.position_sigma_m, config.velocity_sigma_mps)[: 1 + segment.with_velocity]
    precision = np.stack([entering / sigma**2 + ~active for sigma in sigmas], axis=1)
    joints = np.zeros((*precision.shape, 3))
    joints[:, 0][entering] = segment.evidence.guess_m[:, segment.joints][entering]
    return Priors(joints, precision, np.nan_to_num(segment.lengths_m), segment.length_sigma_m**-2)
