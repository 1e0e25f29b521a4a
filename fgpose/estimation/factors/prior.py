"""Weak priors, so that every unknown is determined: where a joint enters the graph, and on the shared lengths."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import gtsam
import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.estimation.factors.state import BatchState, Information
from fgpose.estimation.keys import Keys, length_key
from fgpose.estimation.segment import Segment
from fgpose_factors import noise_model


@dataclass(frozen=True, eq=False)
class Priors:
    """Around the first guess of a joint that enters, and around velocity zero.

    In numpy a joint has unknowns in every frame. In frames where it is not estimated a prior holds them at zero.
    """

    entering: Bool[np.ndarray, "frame slot"]
    absent: Bool[np.ndarray, "frame slot"]
    positions_m: Float[np.ndarray, "frame slot 3"]
    """Zero for joints that do not enter."""
    sigmas: tuple[float, ...]
    """Of the position, m, and, with constant velocity, of the velocity, m/s."""

    @classmethod
    def of(cls, segment: Segment) -> Iterator[Priors]:
        config, active = segment.config.prior, segment.active[:, segment.joints]
        entering = active & ~segment.kept[:, segment.joints]
        positions_m = np.where(entering[..., None], segment.start_m[:, segment.joints], 0.0)
        sigmas = (config.position_sigma_m, config.velocity_sigma_mps)[: 1 + segment.with_velocity]
        yield cls(entering, ~active, positions_m, sigmas)

    def graph_factors(self, keys: Keys) -> Iterator[gtsam.NonlinearFactor]:
        noises = [noise_model(3, sigma) for sigma in self.sigmas]
        for frame, slot in np.argwhere(self.entering).tolist():
            position_m = self.positions_m[frame, slot]
            yield gtsam.PriorFactorPoint3(keys.position(frame, slot), position_m, noises[0])
            for noise in noises[1:]:
                yield gtsam.PriorFactorPoint3(keys.velocity(frame, slot), np.zeros(3), noise)

    def error(self, state: BatchState) -> float:
        return 0.5 * sum(float(np.sum(precision * residual**2)) for precision, residual in self._residuals(state))

    def add_gradient(self, gradient: BatchState, state: BatchState) -> None:
        for kind, (precision, residual) in enumerate(self._residuals(state)):
            gradient.joints[:, kind] += precision * residual

    def add_information(self, information: Information, state: BatchState) -> None:
        for kind, (precision, _) in enumerate(self._residuals(state)):
            information.single_axes[:, kind, kind] += precision

    def _residuals(self, state: BatchState) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Precision and residual of the positions, then of the velocities."""
        for kind, (sigma, mean) in enumerate(zip(self.sigmas, (self.positions_m, 0.0), strict=False)):
            yield (self.entering / sigma**2 + self.absent)[..., None], state.joints[:, kind] - mean


@dataclass(frozen=True, eq=False)
class LengthPriors:
    """Around the first guess of every shared length that is estimated. In numpy the others are held where they are."""

    lengths_m: Float[np.ndarray, " length"]
    """Finite."""
    sigma_m: Float[np.ndarray, " length"]
    estimated: Int[np.ndarray, " estimated"]

    @classmethod
    def of(cls, segment: Segment) -> Iterator[LengthPriors]:
        known = np.isfinite(segment.lengths_m)
        lengths_m = np.where(known, segment.lengths_m, 0.0)
        yield cls(lengths_m, np.where(known, segment.length_sigma_m, 1.0), segment.estimated_lengths)

    def graph_factors(self, keys: Keys) -> Iterator[gtsam.NonlinearFactor]:
        for length in self.estimated.tolist():
            noise = noise_model(1, float(self.sigma_m[length]))
            yield gtsam.PriorFactorDouble(length_key(length), float(self.lengths_m[length]), noise)

    def error(self, state: BatchState) -> float:
        return 0.5 * float(np.sum(((state.lengths_m - self.lengths_m) / self.sigma_m) ** 2))

    def add_gradient(self, gradient: BatchState, state: BatchState) -> None:
        gradient.lengths_m[:] += (state.lengths_m - self.lengths_m) / self.sigma_m**2

    def add_information(self, information: Information, state: BatchState) -> None:
        information.corner += np.diag(self.sigma_m**-2)
