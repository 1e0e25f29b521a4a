"""Robust priors on positions, in numpy: shared by anchors and depths."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.estimation.factors.state import BatchState, Information
from fgpose_factors import Kernel, robust_loss, robust_weight


@dataclass(frozen=True, eq=False)
class PointPriors:
    """The joint is where it was measured, to a covariance of any shape."""

    positions_m: Float[np.ndarray, "frame slot 3"]
    """Finite everywhere."""
    information: Float[np.ndarray, "frame slot 3 3"]
    """Inverse covariance, 1/m^2; zero where there is no prior."""
    kernel: Kernel
    kernel_scale: float

    def error(self, state: BatchState) -> float:
        _, squared = self._residual(state)
        return float(robust_loss(squared, self.kernel, self.kernel_scale).sum())

    def add_gradient(self, gradient: BatchState, state: BatchState) -> None:
        pull, squared = self._residual(state)
        gradient.joints[:, 0] += robust_weight(squared, self.kernel, self.kernel_scale)[..., None] * pull

    def add_information(self, information: Information, state: BatchState) -> None:
        _, squared = self._residual(state)
        weight = robust_weight(squared, self.kernel, self.kernel_scale)
        information.single_positions[:] += weight[..., None, None] * self.information

    def _residual(self, state: BatchState) -> tuple[Float[np.ndarray, "frame slot 3"], Float[np.ndarray, "frame slot"]]:
        """Information times residual, and the squared whitened residual."""
        return state.evaluated(self, self._evaluated)

    def _evaluated(
        self, state: BatchState
    ) -> tuple[Float[np.ndarray, "frame slot 3"], Float[np.ndarray, "frame slot"]]:
        residual_m = state.joints[:, 0] - self.positions_m
        pull = np.einsum("tjik,tjk->tji", self.information, residual_m)
        # Of an information that is nearly singular rounding may make it negative, which no kernel takes.
        return pull, np.maximum(np.einsum("tji,tji->tj", residual_m, pull), 0.0)
