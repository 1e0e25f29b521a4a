"""What the frames before a segment tell about its first frame, after they have been eliminated."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from fgpose.estimation.factors.state import BatchState, Information
from fgpose.estimation.segment import Segment


@dataclass(frozen=True, eq=False)
class Marginals:
    """A quadratic cost of the unknowns of the first frame. It is a part of normal equations only: iSAM2 keeps what it
    eliminates."""

    information: Float[np.ndarray, "slot 3 kind slot 3 kind"]
    gradient: Float[np.ndarray, "kind slot 3"]
    """At `around`."""
    around: Float[np.ndarray, "kind slot 3"]

    @classmethod
    def of(cls, segment: Segment) -> Iterator[Marginals]:
        marginal, joints = segment.marginal, segment.joints
        if marginal is not None:
            information = marginal.information[joints][:, :, :, joints]
            yield cls(information, marginal.gradient[:, joints], marginal.around[:, joints])

    def error(self, state: BatchState) -> float:
        off = state.joints[0] - self.around
        return float((off * (self.gradient + 0.5 * self._pull(off))).sum())

    def add_gradient(self, gradient: BatchState, state: BatchState) -> None:
        gradient.joints[0] += self.gradient + self._pull(state.joints[0] - self.around)

    def add_information(self, information: Information, state: BatchState) -> None:
        information.frames[0] += self.information

    @cached_property
    def _matrix(self) -> Float[np.ndarray, "unknown unknown"]:
        return self.information.reshape(self.around.size, self.around.size)

    def _pull(self, off: Float[np.ndarray, "kind slot 3"]) -> Float[np.ndarray, "kind slot 3"]:
        pull = self._matrix @ off.transpose(1, 2, 0).ravel()
        return pull.reshape(*off.shape[1:], -1).transpose(2, 0, 1)
