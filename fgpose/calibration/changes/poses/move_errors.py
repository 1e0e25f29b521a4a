"""What a fitted move of a camera errs by; and whether it is more than what calibrations of untouched cameras err by."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from fgpose.config import CalibrationConfig


class Linearised(NamedTuple):
    """The angles between the rays of a camera and those of the others, about a fitted move."""

    angle: Float[np.ndarray, "other sample joint"]
    """Whitened, 0 where unknown."""
    weight: Float[np.ndarray, "other sample joint"]
    """Of each in least squares; 0 of those that did not enter."""
    by_own: Float[np.ndarray, "other sample joint 6"]
    """What a move of the camera changes of it."""
    by_other: Float[np.ndarray, "other sample joint 6"]
    """The same of a move of the other one."""


class MoveErrors(NamedTuple):
    """Covariances of a fitted move, its turn before its translation."""

    of_fit: Float[np.ndarray, "6 6"]
    """By errors of the detections, and of the calibrations of the other cameras."""
    of_calibration: Float[np.ndarray, "6 6"]
    """What the calibration of the camera itself errs by, if nobody touched it."""

    def sigma(self, rows: slice) -> float:
        """Standard deviation of the turn or of the translation, root of the sum over the axes."""
        return float(np.sqrt(np.trace(self.of_fit[rows, rows])))

    def untouched(self, move: Float[np.ndarray, " 6"]) -> float:
        """How probably the errors alone of an untouched camera make as large a move.

        The score test of whether moves are larger than errors of the calibration: directions that the recording hardly
        tells count as little. Its statistic is a sum of weighted squares, so about a multiple of chi squared
        (Satterthwaite).
        """
        from scipy.stats import chi2

        unlikely = np.linalg.solve(self.of_fit + self.of_calibration, move)
        statistic = float(unlikely @ self.of_calibration @ unlikely)
        share = np.linalg.solve(self.of_fit + self.of_calibration, self.of_calibration)
        total, squares = float(np.trace(share)), float(np.trace(share @ share))
        return float(chi2.sf(statistic * total / squares, total**2 / squares))


def move_errors(
    seen: Linearised,
    inverse: Float[np.ndarray, "6 6"],
    share: float,
    prior_sigmas: Float[np.ndarray, " 6"],
    block: Int[np.ndarray, " sample"],
) -> MoveErrors:
    """Of a move that fits best.

    What the angles are worth is a guess, what they contradict each other by is not: errors of the detections are told
    by the scatter of the gradients (a sandwich, as that of any other weighting is). They have something in common in
    every block, and in all images of a joint, which a network sees where it is not: so both are clusters.

    Args:
        inverse: of the information, with that of the prior.
        share: by which the information of the angles entered it.
        prior_sigmas: of the move in the fit.
        block: of each sample.
    """
    weighted = seen.weight * seen.angle
    gradient = np.einsum("osj,osja->sja", weighted, seen.by_own, optimize=True)
    entered = seen.weight.any(axis=(0, 2))
    used, number = np.unique(block[entered], return_inverse=True)
    cell = np.zeros((len(used), *gradient.shape[1:]))
    np.add.at(cell, number, gradient[entered])
    alone = cell.reshape(-1, 6)
    scatter = _scatter(cell.sum(axis=1)) + _scatter(cell.sum(axis=0)) - alone.T @ alone
    of_detections = inverse @ (share**2 * _positive(scatter) + np.diag(prior_sigmas**-2)) @ inverse
    by_others = (
        share * inverse @ np.einsum("osj,osja,osjb->oab", seen.weight, seen.by_own, seen.by_other, optimize=True)
    )
    prior = CalibrationConfig()
    calibration = np.diag(np.repeat([np.deg2rad(prior.rotation_sigma_deg), prior.translation_sigma_m], 3) ** 2)
    of_others = np.sum(by_others @ calibration @ by_others.swapaxes(1, 2), axis=0)
    return MoveErrors(of_detections + of_others, calibration)


def _scatter(gradient: Float[np.ndarray, "cluster 6"]) -> Float[np.ndarray, "6 6"]:
    """Of few clusters their own scatter is not known well: n / (n - 1) of its variance, times that of Student's t."""
    n, around = len(gradient), gradient - gradient.mean(axis=0)
    return around.T @ around * n / max(n - 3, 1)


def _positive(scatter: Float[np.ndarray, "6 6"]) -> Float[np.ndarray, "6 6"]:
    """The difference of estimates may be none of a variance."""
    values, axes = np.linalg.eigh(scatter)
    return (axes * np.maximum(values, 0.0)) @ axes.T
