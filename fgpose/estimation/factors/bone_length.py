"""Bone length: a bone and its mirror image have one length, constant over time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.estimation.factors.joint_rows import JointRows
from fgpose.estimation.factors.state import BatchState, Information, summed
from fgpose.estimation.segment import Segment
from fgpose_factors import bone_length_and_direction, noise_model, shared_bone_length_factor, shared_length_residual

# Two joints nearer than this are at one point, and their bone has no direction. Two detections at one pixel in every
# view place them so.
_ONE_POINT_M = 1e-9


@dataclass(frozen=True, eq=False)
class SharedLengths(JointRows):
    """The length is a variable, shared by mirror images and by all frames."""

    length_of_row: Int[np.ndarray, " row"]

    @property
    def lengths(self) -> Int[np.ndarray, " row"]:
        return self.length_of_row

    def residual(
        self, points_m: Sequence[np.ndarray], lengths_m: np.ndarray
    ) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
        start_m, end_m = points_m
        return shared_length_residual(start_m, end_m, lengths_m[self.length_of_row])

    def add_tension(self, information: Information, state: BatchState) -> None:
        """The curvature that Gauss-Newton leaves out, across every bone that is longer than its length.

        A bone under tension resists rotation (geometric stiffness in mechanics). Without this term the steps overshoot
        and oscillate. The curvature of a bone that is too short is negative and is left out.
        """
        positions_m = state.joints[:, 0]
        start, end = self.slots
        distance_m, direction = bone_length_and_direction(positions_m[:, start], positions_m[:, end])
        excess_m = np.maximum(distance_m - state.lengths_m[self.length_of_row], 0.0)
        taut = self.present & (excess_m > 0) & (distance_m > _ONE_POINT_M)
        stiffness = np.divide(excess_m, distance_m * self.sigma_m**2, out=np.zeros_like(excess_m), where=taut)
        along = direction[..., :, None] * direction[..., None, :]
        across = stiffness[..., None, None] * (np.eye(3) - along)
        for one, other in ((start, end), (end, start)):
            information.single_positions[:] += summed(across, one, information.n_slots)
            information.add_between_positions(one, other, -across)

    def factor(self, keys: Sequence[int], row: int) -> gtsam.NonlinearFactor:
        start, end, length = keys
        return shared_bone_length_factor((start, end), length, noise_model(1, float(self.sigma_m[row])))

    def linear_factors(self, keys: Sequence[Sequence[int]], state: BatchState) -> Iterator[gtsam.JacobianFactor]:
        """The factors linearised, all in one expression instead of one callback each.

        Args:
            keys: of every row in every frame where it is present, as joined_keys gives them.
            state: around which.
        """
        residual, jacobians = self.whitened(state)
        by_start, by_end, by_length = (jacobian[self.present][:, None] for jacobian in jacobians)
        noise = gtsam.noiseModel.Unit.Create(1)
        rows = zip(keys, by_start, by_end, by_length, -residual[self.present][:, None], strict=True)
        for (start, end, length), to_start, to_end, to_length, right_hand_side in rows:
            yield gtsam.JacobianFactor(start, to_start, end, to_end, length, to_length, right_hand_side, noise)


@dataclass(frozen=True, eq=False)
class KnownLengths(JointRows):
    """The length is known: GTSAM's native range factors, so that no Python callback is left in iSAM2."""

    lengths_m: Float[np.ndarray, " row"]

    def residual(
        self, points_m: Sequence[np.ndarray], lengths_m: np.ndarray
    ) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
        start_m, end_m = points_m
        residual_m, (by_start, by_end, _) = shared_length_residual(start_m, end_m, self.lengths_m)
        return residual_m, (by_start, by_end)

    def factor(self, keys: Sequence[int], row: int) -> gtsam.NonlinearFactor:
        noise = noise_model(1, float(self.sigma_m[row]))
        return gtsam.RangeFactor3(keys[0], keys[1], float(self.lengths_m[row]), noise)


def bone_lengths(segment: Segment) -> Iterator[SharedLengths | KnownLengths]:
    """Every bone that is complete in some frame and has a first guess of its length."""
    start, end, length = segment.bones
    if not length.size:
        return
    slots = segment.slots[segment.bones[:2]]
    present, sigma_m = segment.active[:, start] & segment.active[:, end], segment.config.symmetry.sigma_m
    if segment.lengths_known:
        assert segment.known is not None
        sigmas_m = np.hypot(sigma_m, segment.known.sigma_m[length])
        apart = _apart(segment.start_m[:, start], segment.start_m[:, end])
        yield KnownLengths(slots, present & apart, sigmas_m, segment.lengths_m[length])
    else:
        yield SharedLengths(slots, present, np.full(length.shape, sigma_m), length)


def _apart(
    start_m: Float[np.ndarray, "frame bone 3"], end_m: Float[np.ndarray, "frame bone 3"]
) -> Bool[np.ndarray, "frame bone"]:
    """Whether the joints start at different points: at distance zero the Jacobian of GTSAM's factor is NaN."""
    return np.asarray(bone_length_and_direction(start_m, end_m)[0] > _ONE_POINT_M)
