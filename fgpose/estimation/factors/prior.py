"""Weak priors, so that every unknown is determined: where a joint enters the graph, and on the shared lengths."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import gtsam
import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.estimation.factors.state import BatchState, Information
from fgpose.estimation.keys import Keys, length_key
from fgpose.estimation.segment import Segment
from fgpose_factors import custom_factor, noise_model


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
    covariance_m2: Float[np.ndarray, "length length"]
    estimated: Int[np.ndarray, " estimated"]

    @classmethod
    def of(cls, segment: Segment) -> Iterator[LengthPriors]:
        lengths_m, sigma_m = segment.lengths_m, np.broadcast_to(segment.length_sigma_m, segment.lengths_m.shape)
        if segment.known is not None:
            before = np.isfinite(segment.known.lengths_m)
            lengths_m = np.where(before, segment.known.lengths_m, lengths_m)
            sigma_m = np.where(before, segment.known.sigma_m, sigma_m)
        known = np.isfinite(lengths_m)
        covariance_m2 = np.diag(np.where(known, sigma_m, 1.0) ** 2)
        if segment.length_covariance_m2 is not None:
            covariance_m2 = np.where(np.outer(known, known), segment.length_covariance_m2, covariance_m2)
        yield cls(np.where(known, lengths_m, 0.0), covariance_m2, segment.estimated_lengths)

    def graph_factors(self, keys: Keys) -> Iterator[gtsam.NonlinearFactor]:
        """One for each length, or one of all where they are correlated."""
        if not len(self.estimated):
            return
        covariance_m2 = self.covariance_m2[np.ix_(self.estimated, self.estimated)]
        if np.array_equal(covariance_m2, np.diag(np.diag(covariance_m2))):
            for length in self.estimated.tolist():
                noise = noise_model(1, float(np.sqrt(self.covariance_m2[length, length])))
                yield gtsam.PriorFactorDouble(length_key(length), float(self.lengths_m[length]), noise)
        else:
            around_m, lengths = (
                self.lengths_m[self.estimated],
                [length_key(length) for length in self.estimated.tolist()],
            )
            noise, columns = gtsam.noiseModel.Gaussian.Covariance(covariance_m2), np.eye(len(lengths))
            yield custom_factor(
                lengths,
                noise,
                lambda *lengths_m: (np.array(lengths_m) - around_m, tuple(columns[:, :, None])),
                [gtsam.Values.atDouble] * len(lengths),
            )

    def error(self, state: BatchState) -> float:
        away_m = state.lengths_m - self.lengths_m
        return 0.5 * float(away_m @ self._information @ away_m)

    def add_gradient(self, gradient: BatchState, state: BatchState) -> None:
        gradient.lengths_m[:] += self._information @ (state.lengths_m - self.lengths_m)

    def add_information(self, information: Information, state: BatchState) -> None:
        information.corner += self._information

    @cached_property
    def _information(self) -> Float[np.ndarray, "length length"]:
        return np.linalg.inv(self.covariance_m2)
