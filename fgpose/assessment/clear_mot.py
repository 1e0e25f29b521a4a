"""The CLEAR-MOT protocol: true and estimated people matched frame by frame, identities kept while they fit.

Bernardin and Stiefelhagen, Evaluating multiple object tracking performance: the CLEAR MOT metrics, 2008.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.assessment.crowd import NOBODY, Crowd


@dataclass(frozen=True)
class TrueTrack:
    """How one true person was followed."""

    n_frames: int
    """Frames in which the person is there."""
    n_matched: int
    n_switches: int
    """Matches to another identity than that of the person's last match, however long ago that is."""
    n_fragmentations: int
    """Times at which the person is lost and matched again later, with whatever identity. Frames in which the person is
    not there do not interrupt."""


def match_frames(
    distances_m: Float[np.ndarray, "frame truth estimate"], truth: Crowd, estimate: Crowd, match_m: float
) -> Int[np.ndarray, "frame truth"]:
    """For each true person of each frame the slot of the estimated one, or NOBODY.

    A pair needs a distance below match_m. First, a true person keeps the identity of the last match, where that is
    there and near enough, even if another is nearer; if two people had the same identity last, the one with the lower
    number keeps it. The others are assigned so that there are as many pairs as possible, with the least sum of
    distances.
    """
    partner = np.full(truth.person.shape, NOBODY)
    last = np.full(len(truth.identities), NOBODY)
    near = distances_m < match_m
    for frame in np.flatnonzero(near.any(axis=(1, 2))):
        people, candidates = truth.person[frame], estimate.person[frame]
        kept = near[frame] & (candidates == last[people][:, None])
        kept &= np.cumsum(kept, axis=0) == 1
        others = near[frame] & ~kept.any(axis=1)[:, None] & ~kept.any(axis=0)
        rows, columns = np.nonzero(kept | _assigned(distances_m[frame], others, match_m))
        partner[frame, rows] = columns
        last[people[rows]] = candidates[columns]
    return partner


def _assigned(
    cost: Float[np.ndarray, "row column"], allowed: Bool[np.ndarray, "row column"], highest: float
) -> Bool[np.ndarray, "row column"]:
    """As many of the allowed pairs as possible, and of these the cheapest; no allowed one costs more than highest."""
    from scipy.optimize import linear_sum_assignment

    if not allowed.any():
        return allowed
    # one pair that is not allowed costs more than all that are
    chosen = linear_sum_assignment(np.where(allowed, cost, (len(cost) + 1) * highest))
    pairs = np.zeros_like(allowed)
    pairs[chosen] = allowed[chosen]
    return pairs


def tracks(partner: Int[np.ndarray, "frame truth"], truth: Crowd, estimate: Crowd) -> tuple[TrueTrack, ...]:
    """How each true identity was followed, given the matches of match_frames."""
    return tuple(_track(partner, truth.person == index, estimate) for index in range(len(truth.identities)))


def _track(
    partner: Int[np.ndarray, "frame truth"], there: Bool[np.ndarray, "frame truth"], estimate: Crowd
) -> TrueTrack:
    frames, slots = np.nonzero(there)
    partners = partner[frames, slots]
    matched = partners != NOBODY
    identities = estimate.person[frames[matched], partners[matched]]
    begins = matched & ~np.append(False, matched[:-1])
    return TrueTrack(
        n_frames=len(frames),
        n_matched=len(identities),
        n_switches=int((np.diff(identities) != 0).sum()),
        n_fragmentations=max(int(begins.sum()) - 1, 0),
    )
