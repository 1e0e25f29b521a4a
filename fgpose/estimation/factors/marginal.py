"""What the frames before a segment tell about its first frame, after they have been eliminated."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from fgpose.estimation.factors.state import BatchState, Information
from fgpose.estimation.segment import Segment


@dataclass(frozen=True, eq=False)
class Marginals:
    """A quadratic cost of the unknowns of the first frame. It is a part of normal equations only: iSAM2 keeps what it
    eliminates."""

    linkages: tuple[Int[np.ndarray, " _"], ...]
    """The slots of each."""
    information: tuple[Float[np.ndarray, "_ 3 kind _ 3 kind"], ...]
    gradient: Float[np.ndarray, "kind slot 3"]
    """At `around`."""
    around: Float[np.ndarray, "kind slot 3"]

    @classmethod
    def of(cls, segment: Segment) -> Iterator[Marginals]:
        marginal, joints = segment.marginal, segment.joints
        if marginal is None:
            return
        information, n_kinds = [], len(marginal.around)
        for of_linkage, block in zip(marginal.information.linkages, marginal.information.blocks, strict=True):
            there = np.flatnonzero(segment.slots[list(of_linkage)] >= 0)
            by_joint = block.reshape(2 * (len(of_linkage), 3, n_kinds))
            information.append(by_joint[there][:, :, :, there] if len(there) < len(of_linkage) else by_joint)
        yield cls(segment.linkages, tuple(information), marginal.gradient[:, joints], marginal.around[:, joints])

    def error(self, state: BatchState) -> float:
        off = state.joints[0] - self.around
        return float((off * (self.gradient + 0.5 * state.evaluated(self, self._pull))).sum())

    def add_gradient(self, gradient: BatchState, state: BatchState) -> None:
        gradient.joints[0] += self.gradient + state.evaluated(self, self._pull)

    def add_information(self, information: Information, state: BatchState) -> None:
        for frames, own in zip(information.frames, self.information, strict=True):
            frames[0] += own

    def _pull(self, state: BatchState) -> Float[np.ndarray, "kind slot 3"]:
        """Beyond that at `around`."""
        off = state.joints[0] - self.around
        by_slot, pull = off.transpose(1, 2, 0), np.empty_like(off)
        for slots, own in zip(self.linkages, self.information, strict=True):
            of_slots = by_slot[slots]
            of_linkage = own.reshape(of_slots.size, of_slots.size) @ of_slots.ravel()
            pull[:, slots] = of_linkage.reshape(of_slots.shape).transpose(2, 0, 1)
        return pull
