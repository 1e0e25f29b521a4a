"""Fading: the velocity of an unseen joint fades to that of the joint that holds it, or to zero."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import gtsam
import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.estimation.evidence.evidence import Evidence
from fgpose.estimation.factors.state import BatchState, Information
from fgpose.estimation.keys import Keys
from fgpose.estimation.segment import Segment
from fgpose.skeleton import Skeleton
from fgpose_factors import fading_velocity_factor, fading_velocity_sigma_mps

_LEAST_UNSEEN = 0.05  # probability below which it would tell next to nothing


@dataclass(frozen=True, eq=False)
class Fading:
    """The residual is the velocity of the joint less that of its reference."""

    frame: Int[np.ndarray, " row"]
    slot: Int[np.ndarray, " row"]
    reference: Int[np.ndarray, " row"]
    """Slot of the joint that holds it; -1: none, the velocity fades to zero."""
    step_s: Float[np.ndarray, " row"]
    density: Float[np.ndarray, " row"]
    """Of the motion factors, m^2/s^3, over the probability that no camera sees the joint: the expected information."""
    fade_s: float

    @classmethod
    def of(cls, segment: Segment) -> Iterator[Fading]:
        """Every joint that maybe no camera sees, in a frame that has a frame before it."""
        unseen = segment.active & maybe_unseen(segment.evidence) & np.isfinite(segment.step_s)[:, None]
        if not segment.with_velocity or not unseen.any():
            return
        frame, joint = np.nonzero(unseen)
        seen = segment.evidence.seen
        holders = [
            holder(segment.skeleton, j, segment.active[f], seen[f])
            for f, j in zip(frame.tolist(), joint.tolist(), strict=True)
        ]
        reference = np.array([-1 if held_by is None else segment.slots[held_by] for held_by in holders])
        density = segment.process_density[frame, joint] / segment.evidence.unseen[frame, joint]
        yield cls(frame, segment.slots[joint], reference, segment.step_s[frame], density, segment.config.motion.fade_s)

    def graph_factors(self, keys: Keys) -> Iterator[gtsam.NonlinearFactor]:
        rows = (self.frame, self.slot, self.reference, self.step_s, self.density)
        for frame, slot, reference, step_s, density in zip(*(values.tolist() for values in rows), strict=True):
            held_by = None if reference < 0 else keys.velocity(frame, reference)
            yield fading_velocity_factor(keys.velocity(frame, slot), held_by, step_s, density, self.fade_s)

    def error(self, state: BatchState) -> float:
        return 0.5 * float(np.sum(self._precision[:, None] * self._residual(state) ** 2))

    def add_gradient(self, gradient: BatchState, state: BatchState) -> None:
        pull, held = self._precision[:, None] * self._residual(state), self.reference >= 0
        by_velocity = gradient.joints[:, 1]
        by_velocity[self.frame, self.slot] += pull
        np.subtract.at(by_velocity, (self.frame[held], self.reference[held]), pull[held])  # one may hold many

    def add_information(self, information: Information, state: BatchState) -> None:
        held = self.reference >= 0
        frame, slot, reference, precision = (
            values[held] for values in (self.frame, self.slot, self.reference, self._precision)
        )
        of_velocity = information.single_axes[:, 1, 1]
        of_velocity[self.frame, self.slot] += self._precision[:, None]
        np.add.at(of_velocity, (frame, reference), precision[:, None])
        information.add_between_velocities(frame, slot, reference, -precision)

    @cached_property
    def _precision(self) -> Float[np.ndarray, " row"]:
        return np.asarray(fading_velocity_sigma_mps(self.step_s, self.density, self.fade_s)) ** -2

    def _residual(self, state: BatchState) -> Float[np.ndarray, "row 3"]:
        velocities_mps = state.joints[:, 1]
        reference_mps = velocities_mps[self.frame, self.reference] * (self.reference >= 0)[:, None]
        return velocities_mps[self.frame, self.slot] - reference_mps


def maybe_unseen(evidence: Evidence) -> Bool[np.ndarray, "frame joint"]:
    """Joints whose velocity fades."""
    return evidence.unseen > _LEAST_UNSEEN


def with_references(
    joints: Bool[np.ndarray, " joint"], unseen: Bool[np.ndarray, " joint"], skeleton: Skeleton
) -> Bool[np.ndarray, " joint"]:
    """These joints and all to whose velocities theirs may fade, so that no fading factor leads out of them.

    Args:
        joints: of one frame.
        unseen: maybe_unseen of that frame.
        skeleton: for the neighbours.
    """
    found = joints.copy()
    to_follow = np.flatnonzero(joints).tolist()
    while to_follow:
        joint = to_follow.pop()
        if unseen[joint]:
            others = [other for other in skeleton.neighbours[joint] if not found[other]]
            found[others] = True
            to_follow += others
    return found


def holder(
    skeleton: Skeleton, joint: int, active: Bool[np.ndarray, " joint"], seen: Bool[np.ndarray, " joint"]
) -> int | None:
    """The neighbour that an unseen joint moves with: a seen one, or the one nearer to the root."""
    neighbours = [other for other in skeleton.neighbours[joint] if active[other]]
    seen_neighbours = [other for other in neighbours if seen[other]]
    parents = [a for a, b in skeleton.bones if b == joint and active[a]]
    return next(iter(seen_neighbours + parents), None)
