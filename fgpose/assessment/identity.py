"""Measures of identity over a whole recording: IDF1 and HOTA.

Below, N truth and M estimated identities; a pair count is (N, M): in how many frames a pair of identities fits.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.assessment.crowd import Crowd

# The similarity of two people falls from 1 to 0 over this distance.
HOTA_REACH_M = 1.0
HOTA_ALPHAS = np.arange(1, 20) / 20


def share(part: int, whole: int) -> float:
    """Part of a whole; NaN where there is no whole."""
    return float(part / whole) if whole else float("nan")


@dataclass(frozen=True)
class IdentityScore:
    """Precision, recall and F1 of the frames in which the right identity is there."""

    idp: float
    idr: float
    idf1: float


@dataclass(frozen=True)
class Hota:
    """HOTA and its parts, each the mean over HOTA_ALPHAS."""

    hota: float
    det_a: float
    """Detection: TP / (TP + FN + FP)."""
    ass_a: float
    """Association: mean over the TP of TPA / (TPA + FNA + FPA)."""


def identity_score(
    distances_m: Float[np.ndarray, "frame truth estimate"], truth: Crowd, estimate: Crowd, match_m: float
) -> IdentityScore:
    """IDP, IDR and IDF1 (Ristani et al., Performance measures and a data set for multi-target, multi-camera tracking,
    2016): each true identity is paired with at most one estimated one for the whole recording, such that the most
    frames fit, that is have a distance below match_m."""
    from scipy.optimize import linear_sum_assignment

    counts = _pair_counts(distances_m < match_m, truth, estimate)
    n_right = int(counts[linear_sum_assignment(counts, maximize=True)].sum())
    return IdentityScore(
        idp=share(n_right, estimate.n_there),
        idr=share(n_right, truth.n_there),
        idf1=share(2 * n_right, truth.n_there + estimate.n_there),
    )


def hota(distances_m: Float[np.ndarray, "frame truth estimate"], truth: Crowd, estimate: Crowd) -> Hota:
    """HOTA, DetA and AssA (Luiten et al., HOTA: a higher order metric for evaluating multi-object tracking, 2020).

    The similarity of two people is max(0, 1 - distance / 1 m); at each alpha they may be matched where it is at least
    alpha. The matching is the paper's (eq. 15), made anew at each alpha: in each frame as many pairs as possible, then
    the best association, then the greatest similarity. TrackEval maximises association x similarity before it applies
    alpha and so may find fewer pairs. NaN where nobody is there on either side.
    """
    similarity = np.where(distances_m < HOTA_REACH_M, 1 - distances_m / HOTA_REACH_M, 0.0)
    scores = np.array([_hota_at(alpha, similarity, truth, estimate) for alpha in HOTA_ALPHAS])
    return Hota(*scores.mean(axis=0).tolist())


def _hota_at(
    alpha: float, similarity: Float[np.ndarray, "frame truth estimate"], truth: Crowd, estimate: Crowd
) -> tuple[float, float, float]:
    """HOTA, DetA and AssA at one alpha."""
    # rounding of the similarity must not decide
    fits = similarity >= alpha - 1e-12
    association = _jaccard(_pair_counts(fits, truth, estimate), truth, estimate)
    possible = association[truth.person[:, :, None], estimate.person[:, None, :]]
    counts = _pair_counts(_matched(fits, possible, similarity), truth, estimate)
    n_matched = int(counts.sum())
    det_a = share(n_matched, truth.n_there + estimate.n_there - n_matched)
    ass_a = float((counts * _jaccard(counts, truth, estimate)).sum() / max(n_matched, 1))
    return (det_a * ass_a) ** 0.5, det_a, ass_a


def _pair_counts(
    pairs: Bool[np.ndarray, "frame truth estimate"], truth: Crowd, estimate: Crowd
) -> Int[np.ndarray, "identity other"]:
    frame, row, column = np.nonzero(pairs)
    shape = len(truth.identities), len(estimate.identities)
    flat = truth.person[frame, row] * shape[1] + estimate.person[frame, column]
    return np.bincount(flat, minlength=shape[0] * shape[1]).reshape(shape)


def _jaccard(
    counts: Int[np.ndarray, "identity other"], truth: Crowd, estimate: Crowd
) -> Float[np.ndarray, "identity other"]:
    """TPA / (TPA + FNA + FPA) of each pair of identities, where counts are its TPA; 0 where neither is ever there."""
    either = truth.n_frames_there[:, None] + estimate.n_frames_there - counts
    return counts / np.maximum(either, 1)


def _matched(
    fits: Bool[np.ndarray, "frame truth estimate"],
    possible: Float[np.ndarray, "frame truth estimate"],
    similarity: Float[np.ndarray, "frame truth estimate"],
) -> Bool[np.ndarray, "frame truth estimate"]:
    """One-to-one pairs of each frame with the greatest sum of eq. 15, 1/epsilon + association + epsilon x similarity.

    Args:
        possible: association of the two identities if all pairs that fit were matched.
    """
    from scipy.optimize import linear_sum_assignment

    # epsilon decides between equal associations only; the constant outweighs all pairs of a frame together
    score = np.where(fits, 1 + fits.shape[1] + possible + 1e-9 * similarity, 0.0)
    ambiguous = (fits.sum(axis=1) > 1).any(axis=-1) | (fits.sum(axis=2) > 1).any(axis=-1)
    matched = fits & ~ambiguous[:, None, None]
    for frame in np.flatnonzero(ambiguous):
        chosen = linear_sum_assignment(score[frame], maximize=True)
        matched[frame][chosen] = fits[frame][chosen]
    return matched
