"""The poses of matched people: whose joints they are, and which limbs are correct."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from fgpose.assessment.crowd import NOBODY, Crowd


def matched_positions_m(
    partner: Int[np.ndarray, "frame truth"], estimate: Crowd
) -> Float[np.ndarray, "frame truth joint 3"]:
    """Estimated joints of each true person of each frame, metres; NaN where nobody is matched.

    Args:
        partner: slot of the estimate, or NOBODY.
    """
    n_joints = estimate.positions_m.shape[2]
    result = np.full((*partner.shape, n_joints, 3), np.nan)
    frames, rows = np.nonzero(partner != NOBODY)
    result[frames, rows] = estimate.positions_m[frames, partner[frames, rows]]
    return result


def correct_limbs(
    errors_m: Float[np.ndarray, "frame person joint"],
    truth_m: Float[np.ndarray, "frame person joint 3"],
    bones: Sequence[tuple[int, int]],
    alpha: float,
) -> Float[np.ndarray, "frame person bone"]:
    """1 where the mean error of a limb's two ends is at most alpha times its true length, else 0, as where an end is
    not estimated; NaN where the truth does not know the limb. The mean is PCP in 3D.

    Args:
        errors_m: of the joints; NaN = missing.
    """
    a, b = np.array(bones, dtype=int).reshape(-1, 2).T
    length_m = np.linalg.norm(truth_m[:, :, a] - truth_m[:, :, b], axis=-1)
    correct = (errors_m[:, :, a] + errors_m[:, :, b]) / 2 <= alpha * length_m
    return np.where(np.isnan(length_m), np.nan, correct)


def on_another(
    matched_m: Float[np.ndarray, "frame person joint 3"],
    errors_m: Float[np.ndarray, "frame person joint"],
    truth_m: Float[np.ndarray, "frame person joint 3"],
    near_m: float,
) -> Float[np.ndarray, "frame person joint"]:
    """1 where an estimated joint is farther than near_m from its own person's true joint, and at most that far from the
    same joint of another true person, else 0; NaN where the estimate or the own truth is missing.

    Args:
        matched_m: estimated joints of each true person.
        errors_m: their distances from the person's own true joints.
    """
    near_somebody = np.zeros(errors_m.shape, dtype=bool)
    for person in range(truth_m.shape[1]):
        near_somebody |= np.linalg.norm(matched_m - truth_m[:, person, None], axis=-1) <= near_m
    return np.where(np.isnan(errors_m), np.nan, near_somebody & (errors_m > near_m))
