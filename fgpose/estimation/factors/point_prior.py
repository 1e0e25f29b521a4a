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
        residual_m = state.joints[:, 0] - self.positions_m
        return float(robust_loss(self._squared(residual_m), self.kernel, self.kernel_scale).sum())

    def add_gradient(self, gradient: BatchState, state: BatchState) -> None:
        residual_m = state.joints[:, 0] - self.positions_m
        gradient.joints[:, 0] += (self._weighted(residual_m) @ residual_m[..., None])[..., 0]

    def add_information(self, information: Information, state: BatchState) -> None:
        information.single_positions[:] += self._weighted(state.joints[:, 0] - self.positions_m)

    def _weighted(self, residual_m: np.ndarray) -> Float[np.ndarray, "frame slot 3 3"]:
        weight = robust_weight(self._squared(residual_m), self.kernel, self.kernel_scale)
        return weight[..., None, None] * self.information

    def _squared(self, residual_m: np.ndarray) -> Float[np.ndarray, "frame slot"]:
        return np.einsum("tji,tjik,tjk->tj", residual_m, self.information, residual_m)
