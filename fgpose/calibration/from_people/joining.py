"""Whole shifts between the clocks of all cameras: one camera after the other joins those whose moments are common."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Int

from fgpose.calibration.from_people.correlation import Correlation, correlate, peaks
from fgpose.calibration.from_people.epipolar_shift import fit_epipolar_shift
from fgpose.calibration.from_people.motion_signals import RATE_HZ, MotionSignals
from fgpose.calibration.from_people.views import View

_MAX_PEAKS = 8
_MIN_PEAK = 0.4  # of the highest one
_MAX_PARTNERS = 3
# Of random signals the highest of a few thousand shifts is about 4.
_MIN_SCORE = 5.0
_DECISIVE = 1.15


@dataclass(frozen=True)
class Proposal:
    """A moment at which a camera may have joined, by the clock of the others."""

    offset_s: float
    """Common time = own time + offset_s."""
    score: float
    """Of the correlations with the others, in standard deviations of chance."""
    misfit: float
    """Of the epipolar geometries with some of them, see EpipolarShift."""

    @property
    def support(self) -> float:
        """The score, the less the worse the joints fit."""
        return self.score * (1 - self.misfit)


@dataclass(frozen=True)
class Joined:
    """How a camera joined the others."""

    camera: int
    best: Proposal
    second: Proposal | None
    """The next best."""

    @property
    def is_decisive(self) -> bool:
        second = 0.0 if self.second is None else self.second.support
        return self.best.score >= _MIN_SCORE and self.best.support >= _DECISIVE * second


def join_cameras(
    signals: Sequence[MotionSignals], views: Sequence[View]
) -> tuple[dict[int, float], dict[int, Joined]]:
    """Offsets of the cameras that could be joined, of one of them 0, and how each of the others joined or failed to.

    It begins with the two cameras whose correlation has the most outstanding peak. Then always the camera joins whose
    correlation with all those that have joined, summed up at shifts that are consistent with theirs, has the most
    outstanding peak. Which peak is right is decided by how well the joints satisfy an epipolar geometry there. A camera
    for which that is not decisive waits until the others have joined.
    """
    pairs = _correlations(signals)
    offsets_s: dict[int, float] = {}
    outcome: dict[int, Joined] = {}
    waiting = [camera for camera in range(len(signals)) if signals[camera].known.any()]
    if len(waiting) < 2:
        return offsets_s, outcome
    for one, other in sorted(combinations(waiting, 2), key=lambda pair: -_outstanding(pairs[pair].score)):
        joined = _proposed(other, {one: 0.0}, pairs, views)
        if joined is not None and joined.is_decisive:
            offsets_s = {one: 0.0, other: joined.best.offset_s}
            outcome[other] = joined
            break
        if joined is not None:
            outcome[other] = joined
    if not offsets_s:
        return offsets_s, outcome
    waiting = [camera for camera in waiting if camera not in offsets_s]
    postponed: list[int] = []
    while waiting:
        camera = max(waiting, key=lambda camera: _outstanding(_together(camera, offsets_s, pairs)[1]))
        joined = _proposed(camera, offsets_s, pairs, views)
        waiting.remove(camera)
        if joined is not None:
            outcome[camera] = joined
        if joined is not None and joined.is_decisive:
            offsets_s[camera] = joined.best.offset_s
            waiting, postponed = waiting + postponed, []
        else:
            postponed.append(camera)
    return offsets_s, outcome


def _correlations(signals: Sequence[MotionSignals]) -> dict[tuple[int, int], Correlation]:
    """Of every two cameras, in both orders."""
    pairs = {}
    for one, other in combinations(range(len(signals)), 2):
        pairs[one, other] = correlate(signals[one], signals[other])
        pairs[other, one] = pairs[one, other].mirrored
    return pairs


def _outstanding(score: np.ndarray) -> float:
    """By how much the highest peak is above the next."""
    highest = score[peaks(score, 2)]
    return float(highest[0] - highest[1:].sum()) if len(highest) else 0.0


def _together(
    camera: int, offsets_s: Mapping[int, float], pairs: Mapping[tuple[int, int], Correlation]
) -> tuple[Int[np.ndarray, " offset"], np.ndarray]:
    """Offsets of a camera in samples, and what the correlations with all others say together."""
    known = {one: round(offset_s * RATE_HZ) for one, offset_s in offsets_s.items()}
    ranges = [(pairs[one, camera].first_shift + at, len(pairs[one, camera].score)) for one, at in known.items()]
    low, high = min(first for first, _ in ranges), max(first + n for first, n in ranges)
    offsets = np.arange(low, high)
    scores = np.array([pairs[one, camera].at(offsets - at) for one, at in known.items()])
    return offsets, scores.sum(axis=0) / np.sqrt(len(scores))


def _proposed(
    camera: int,
    offsets_s: Mapping[int, float],
    pairs: Mapping[tuple[int, int], Correlation],
    views: Sequence[View],
) -> Joined | None:
    """The best and the second best moment; None where none is possible."""
    offsets, score = _together(camera, offsets_s, pairs)
    highest = peaks(score, _MAX_PEAKS)
    found = [
        _judged(camera, offsets[peak] / RATE_HZ, float(score[peak]), offsets_s, pairs, views)
        for peak in highest
        if score[peak] >= _MIN_PEAK * score[highest[0]]
    ]
    found.sort(key=lambda proposal: -proposal.support)
    return Joined(camera, found[0], found[1] if len(found) > 1 else None) if found else None


def _judged(
    camera: int,
    offset_s: float,
    score: float,
    offsets_s: Mapping[int, float],
    pairs: Mapping[tuple[int, int], Correlation],
    views: Sequence[View],
) -> Proposal:
    """A peak, refined by the epipolar geometries with those that have most in common with the camera then."""

    def in_common(one: int) -> float:
        shift = np.array([round((offset_s - offsets_s[one]) * RATE_HZ)])
        return float(pairs[one, camera].at(shift)[0])

    partners = sorted(offsets_s, key=in_common, reverse=True)[:_MAX_PARTNERS]
    fits = [fit_epipolar_shift(views[one], views[camera], offset_s - offsets_s[one]) for one in partners]
    known = [(one, fit) for one, fit in zip(partners, fits, strict=True) if fit is not None]
    if not known:
        return Proposal(offset_s, score, 1.0)
    weight = np.array([fit.n_points for _, fit in known], dtype=float)
    refined_s = [offsets_s[one] + fit.shift_s for one, fit in known]
    misfit = float(np.average([fit.misfit for _, fit in known], weights=weight))
    return Proposal(float(np.median(refined_s)), score, misfit)
