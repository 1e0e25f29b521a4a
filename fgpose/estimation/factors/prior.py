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
from fgpose.estimation.noise import shared_errors
from fgpose.estimation.segment import Segment
from fgpose.kinematics.proportions import usual_lengths
from fgpose.skeleton import BoneLengths, Skeleton
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
        return 0.5 * sum(float((precision * residual**2).sum()) for precision, residual in self._residuals(state))

    def add_gradient(self, gradient: BatchState, state: BatchState) -> None:
        for kind, (precision, residual) in enumerate(self._residuals(state)):
            gradient.joints[:, kind] += precision * residual

    def add_information(self, information: Information, state: BatchState) -> None:
        for kind, precision in enumerate(self._precisions):
            information.single_axes[:, kind, kind] += precision

    def _residuals(self, state: BatchState) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Precision and residual of the positions, then of the velocities."""
        for kind, (precision, mean) in enumerate(zip(self._precisions, (self.positions_m, 0.0), strict=False)):
            yield precision, state.joints[:, kind] - mean

    @cached_property
    def _precisions(self) -> list[Float[np.ndarray, "frame slot 1"]]:
        return [(self.entering / sigma**2 + self.absent)[..., None] for sigma in self.sigmas]


@dataclass(frozen=True, eq=False)
class LengthPriors:
    """Of the shared lengths that are estimated: what the proportions of the body say, the first guess where they do
    not, and what was known before. So detections that hardly tell do not make quite another body: with two cameras a
    hallucinated joint makes a bone longer by decimetres. In numpy the others are held where they are."""

    lengths_m: Float[np.ndarray, " length"]
    """Finite."""
    covariance_m2: Float[np.ndarray, "length length"]
    estimated: Int[np.ndarray, " estimated"]

    @classmethod
    def of(cls, segment: Segment) -> Iterator[LengthPriors]:
        if segment.lengths_known:
            return
        lengths_m, covariance_m2 = np.nan_to_num(segment.lengths_m), np.eye(segment.n_lengths)
        estimated = segment.estimated_lengths
        if len(estimated):
            guess = segment.lengths_m, segment.config.prior.length_sigma_m
            mean_m, found_m2 = length_prior(segment.skeleton, segment.known, *guess)
            lengths_m[estimated] = mean_m[estimated]
            # In the graph errors of different frames are independent.
            found_m2 = found_m2 / shared_errors(segment.evidence.time_s) ** 2
            covariance_m2[np.ix_(estimated, estimated)] = found_m2[np.ix_(estimated, estimated)]
        yield cls(lengths_m, covariance_m2, estimated)

    def graph_factors(self, keys: Keys) -> Iterator[gtsam.NonlinearFactor]:
        if not len(self.estimated):
            return
        around_m, lengths = self.lengths_m[self.estimated], [length_key(each) for each in self.estimated.tolist()]
        covariance_m2, columns = self.covariance_m2[np.ix_(self.estimated, self.estimated)], np.eye(len(lengths))
        yield custom_factor(
            lengths,
            gtsam.noiseModel.Gaussian.Covariance(covariance_m2),
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
        return np.linalg.inv(self.covariance_m2) if len(self.estimated) else self.covariance_m2  # an identity


def length_prior(
    skeleton: Skeleton, before: BoneLengths | None, guess_m: Float[np.ndarray, " length"], guess_sigma_m: float
) -> tuple[Float[np.ndarray, " length"], Float[np.ndarray, "length length"]]:
    """Mean and covariance of somebody's lengths: what the proportions of the body say, the first guess where they do
    not, which may be zero or NaN, and what is known from before."""
    mean_m, covariance_m2 = usual_lengths(skeleton, guess_m, guess_sigma_m)
    if before is None:
        return mean_m, covariance_m2
    known = np.isfinite(before.lengths_m)
    mean_m = np.where(known & ~np.isfinite(mean_m), before.lengths_m, mean_m)
    measured_m2 = covariance_m2[np.ix_(known, known)] + np.diag(before.sigma_m[known] ** 2)
    gain = np.linalg.solve(measured_m2, covariance_m2[known]).T
    return mean_m + gain @ (before.lengths_m - mean_m)[known], covariance_m2 - gain @ covariance_m2[known]
