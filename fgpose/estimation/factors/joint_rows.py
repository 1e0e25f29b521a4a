"""Scalar residuals between several joints of a frame, in numpy: shared by bone lengths and symmetry."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.estimation.factors.state import BatchState, Information, summed
from fgpose.estimation.keys import Keys, length_key


@dataclass(frozen=True, eq=False)
class JointRows(ABC):
    """A row is a scalar residual of the positions of several joints, and perhaps of a shared length; it occurs in many
    frames. A subclass defines the residual and the GTSAM factor of a row."""

    slots: Int[np.ndarray, "point row"]
    """The joints of each row, in the order of the residual's arguments."""
    present: Bool[np.ndarray, "frame row"]
    sigma_m: Float[np.ndarray, " row"]

    @property
    def lengths(self) -> Int[np.ndarray, " row"] | None:
        """The shared length that each row joins; None when rows join positions only."""
        return None

    @abstractmethod
    def residual(
        self, points_m: Sequence[Float[np.ndarray, "frame row 3"]], lengths_m: Float[np.ndarray, " length"]
    ) -> tuple[Float[np.ndarray, "frame row 1"], Sequence[Float[np.ndarray, "frame row 1 _"]]]:
        """Residual in metres and its Jacobians by the points and then by the length, if there is one."""

    @abstractmethod
    def factor(self, keys: Sequence[int], row: int) -> gtsam.NonlinearFactor:
        """The factor of a row on these keys, in the same order."""

    def graph_factors(self, keys: Keys) -> Iterator[gtsam.NonlinearFactor]:
        for (_, row), joined in zip(np.argwhere(self.present).tolist(), self.joined_keys(keys), strict=True):
            yield self.factor(joined, row)

    def joined_keys(self, keys: Keys) -> list[list[int]]:
        """The keys that each row joins, frame by frame, where it is present."""
        slots = self.slots.T.tolist()
        lengths = [[]] * len(slots) if self.lengths is None else [[length_key(n)] for n in self.lengths.tolist()]
        return [
            [*(keys.position(frame, slot) for slot in slots[row]), *lengths[row]]
            for frame, row in np.argwhere(self.present).tolist()
        ]

    def whitened(
        self, state: BatchState
    ) -> tuple[Float[np.ndarray, "frame row"], tuple[Float[np.ndarray, "frame row _"], ...]]:
        """Residual and its Jacobians in sigmas; zero where a row is not present."""
        return state.evaluated(self, self._whitened)

    def _whitened(
        self, state: BatchState
    ) -> tuple[Float[np.ndarray, "frame row"], tuple[Float[np.ndarray, "frame row _"], ...]]:
        positions_m = state.joints[:, 0]
        residual_m, jacobians = self.residual([positions_m[:, slots] for slots in self.slots], state.lengths_m)
        weight = (self.present / self.sigma_m)[..., None]
        return (weight * residual_m)[..., 0], tuple(weight * jacobian[..., 0, :] for jacobian in jacobians)

    def error(self, state: BatchState) -> float:
        residual, _ = self.whitened(state)
        return 0.5 * float((residual**2).sum())

    def add_gradient(self, gradient: BatchState, state: BatchState) -> None:
        residual, jacobians = self.whitened(state)
        self._add_pull(gradient, residual, jacobians)

    def add_remainder(self, gradient: BatchState, state: BatchState, step: BatchState) -> None:
        """J^T of what a step changes in the residuals beyond their linearisation, r(x + s) - r(x) - J s."""
        residual, jacobians = self.whitened(state)
        moved, _ = self.whitened(BatchState(state.joints + step.joints, state.lengths_m + step.lengths_m))
        steps = [step.joints[:, 0, slots] for slots in self.slots]
        if self.lengths is not None:
            steps.append(np.broadcast_to(step.lengths_m[self.lengths, None], jacobians[-1].shape))
        linear = sum(np.einsum("tri,tri->tr", *pair) for pair in zip(jacobians, steps, strict=True))
        self._add_pull(gradient, moved - residual - linear, jacobians)

    def _add_pull(self, gradient: BatchState, residual: np.ndarray, jacobians: tuple[np.ndarray, ...]) -> None:
        """J^T r."""
        for slots, jacobian in zip(self.slots, jacobians, strict=False):
            gradient.joints[:, 0] += summed(residual[..., None] * jacobian, slots, gradient.joints.shape[2])
        if self.lengths is not None:
            np.add.at(gradient.lengths_m, self.lengths, np.sum(residual * jacobians[-1][..., 0], axis=0))

    def add_information(self, information: Information, state: BatchState) -> None:
        _, jacobians = self.whitened(state)
        by_points = jacobians[: len(self.slots)]
        information.add_rows(tuple(self.slots), by_points)
        if self.lengths is None:
            return
        by_length = jacobians[-1]
        for slots, by_point in zip(self.slots, by_points, strict=True):
            product = by_point * by_length
            for row, (slot, length) in enumerate(zip(slots.tolist(), self.lengths.tolist(), strict=True)):
                information.border[:, slot, :, 0, length] += product[:, row]
        np.add.at(information.corner, (self.lengths, self.lengths), np.sum(by_length[..., 0] ** 2, axis=0))
