"""The unknowns of a segment as arrays, and the information matrix over them that every kind of factor adds to."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TypeVar, cast

import numpy as np
from jaxtyping import Float, Int

Evaluation = TypeVar("Evaluation")


@dataclass(frozen=True, eq=False)
class BatchState:
    """Everything that is unknown in a segment of frames, or a step or a gradient of it."""

    joints: Float[np.ndarray, "frame kind joint 3"]
    """Positions in m and, with constant velocity, velocities in m/s."""
    lengths_m: Float[np.ndarray, " length"]
    _evaluations: dict[object, object] = field(default_factory=dict, init=False, repr=False)

    def evaluated(self, factors: object, evaluate: Callable[[BatchState], Evaluation]) -> Evaluation:
        """What these factors are here, evaluated once: error, gradient and information of a state all ask for it."""
        if factors not in self._evaluations:
            self._evaluations[factors] = evaluate(self)
        return cast(Evaluation, self._evaluations[factors])


class Information:
    """Gauss-Newton's information matrix of a cost around a state, within each linkage: no factor joins two of them
    (Segment.linkages). Unknowns are ordered by joint, axis, kind.

    Args:
        linkages: the slots of each.
        frames: of each, zeros to add to; given because they are by far the largest arrays of a run.
        n_lengths: how many lengths there are.
    """

    def __init__(
        self,
        linkages: Sequence[Int[np.ndarray, " _"]],
        frames: Sequence[Float[np.ndarray, "frame _ 3 kind _ 3 kind"]],
        n_lengths: int,
    ) -> None:
        self.linkages, self.frames = linkages, frames
        self.n_slots = sum(len(slots) for slots in linkages)
        n_frames, _, _, n_kinds = frames[0].shape[:4]
        self.single: Float[np.ndarray, "frame slot 3 kind 3 kind"] = np.zeros(
            (n_frames, self.n_slots, *2 * (3, n_kinds))
        )
        """Of each joint alone, as far as it is not in frames yet: see spread."""
        self.border = np.zeros((n_frames, self.n_slots, 3, n_kinds, n_lengths))
        self.corner = np.zeros((n_lengths, n_lengths))
        self._linkage, self._place = np.empty((2, self.n_slots), dtype=int)
        for number, slots in enumerate(linkages):
            self._linkage[slots], self._place[slots] = number, np.arange(len(slots))

    @property
    def single_positions(self) -> Float[np.ndarray, "frame slot 3 3"]:
        """Of each position alone; a view."""
        return self.single[:, :, :, 0, :, 0]

    @property
    def single_axes(self) -> Float[np.ndarray, "frame kind kind slot 3"]:
        """Between the kinds of one joint along one axis; a view."""
        return np.einsum("tjakal->tklja", self.single)

    @property
    def single_unknowns(self) -> Float[np.ndarray, "frame kind slot 3"]:
        """Of each unknown alone; a view."""
        return np.einsum("tjakak->tkja", self.single)

    def spread(self) -> None:
        """Add what there is of each joint alone to frames. Once for all kinds of factors: each linkage costs calls."""
        for frames, slots in zip(self.frames, self.linkages, strict=True):
            np.einsum("tjakjbl->tjakbl", frames)[:] += self.single[:, slots]
        self.single[:] = 0.0

    def add_between_positions(
        self, one: Int[np.ndarray, " row"], other: Int[np.ndarray, " row"], blocks: Float[np.ndarray, "frame row 3 3"]
    ) -> None:
        """Of the position of one joint, in the rows of the matrix, and that of another one, in its columns; no two
        blocks may be of the same two."""
        for frames, rows in self._within(one, other):
            at, across = self._place[one[rows]], self._place[other[rows]]
            frames[:, at, :, 0, across, :, 0] += blocks[:, rows].swapaxes(0, 1)

    def add_between_velocities(
        self,
        frame: Int[np.ndarray, " row"],
        one: Int[np.ndarray, " row"],
        other: Int[np.ndarray, " row"],
        values: Float[np.ndarray, " row"],
    ) -> None:
        """Along every axis, of two joints in a frame; on both sides of the diagonal."""
        for frames, rows in self._within(one, other):
            at, across = self._place[one[rows]], self._place[other[rows]]
            for axis in range(3):
                frames[frame[rows], at, axis, 1, across, axis, 1] += values[rows]
                frames[frame[rows], across, axis, 1, at, axis, 1] += values[rows]

    def add_rows(
        self, joints: Sequence[Int[np.ndarray, " row"]], jacobians: Sequence[Float[np.ndarray, "frame row 3"]]
    ) -> None:
        """J^T J of scalar residuals, each on the positions of several joints of a frame.

        No two rows may share a pair of joints.
        """
        for first, by_first in zip(joints, jacobians, strict=True):
            for second, by_second in zip(joints, jacobians, strict=True):
                product = by_first[..., :, None] * by_second[..., None, :]
                if first is second:
                    self.single_positions[:] += summed(product, first, self.n_slots)
                else:
                    self.add_between_positions(first, second, product)

    def _within(
        self, one: Int[np.ndarray, " row"], other: Int[np.ndarray, " row"]
    ) -> Iterator[tuple[Float[np.ndarray, "frame own 3 kind own 3 kind"], Int[np.ndarray, " own_row"]]]:
        """Each linkage with the rows whose joints are in it. Raises ValueError if those of a row are in two."""
        linkage = self._linkage[one]
        if (linkage != self._linkage[other]).any():
            raise ValueError("a factor joins joints of two linkages; see Skeleton.linkages")
        for number, frames in enumerate(self.frames):
            rows = np.flatnonzero(linkage == number)
            if rows.size:
                yield frames, rows


def summed(
    of_rows: Float[np.ndarray, "frame row *values"], joints: Int[np.ndarray, " row"], n_joints: int
) -> Float[np.ndarray, "frame joint *values"]:
    """Over the rows of each joint; it may occur in several or in none."""
    n_frames, n_rows, *values = of_rows.shape
    occurs = (joints == np.arange(n_joints)[:, None]).astype(float)
    return (occurs @ of_rows.reshape(n_frames, n_rows, -1)).reshape(n_frames, n_joints, *values)
