"""The unknowns of a segment as arrays, and the information matrix over them that every kind of factor adds to."""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
    """Gauss-Newton's information matrix of a cost around a state. A frame's unknowns are ordered by joint, axis, kind.

    Args:
        frames: zeros to add to; given because it is by far the largest array of a run.
        n_lengths: how many lengths there are.
    """

    def __init__(self, frames: Float[np.ndarray, "frame joint 3 kind joint 3 kind"], n_lengths: int) -> None:
        self.frames = frames
        self.border = np.zeros((*frames.shape[:4], n_lengths))
        self.corner = np.zeros((n_lengths, n_lengths))

    @property
    def positions(self) -> Float[np.ndarray, "frame joint 3 joint 3"]:
        """Of the positions of a frame; a view."""
        return self.frames[:, :, :, 0, :, :, 0]

    @property
    def single_positions(self) -> Float[np.ndarray, "frame joint 3 3"]:
        """Of each position alone; a view."""
        return np.einsum("tjajb->tjab", self.positions)

    @property
    def single_axes(self) -> Float[np.ndarray, "frame kind kind joint 3"]:
        """Between the kinds of one joint along one axis; a view."""
        return np.einsum("tjakjal->tklja", self.frames)

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
                    self.single_positions[:] += summed(product, first, self.frames.shape[1])
                else:
                    self.positions[:, first, :, second] += product.swapaxes(0, 1)


def summed(
    of_rows: Float[np.ndarray, "frame row *values"], joints: Int[np.ndarray, " row"], n_joints: int
) -> Float[np.ndarray, "frame joint *values"]:
    """Over the rows of each joint; it may occur in several or in none."""
    n_frames, n_rows, *values = of_rows.shape
    occurs = (joints == np.arange(n_joints)[:, None]).astype(float)
    return (occurs @ of_rows.reshape(n_frames, n_rows, -1)).reshape(n_frames, n_joints, *values)
