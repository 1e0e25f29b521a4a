"""Whole shifts between the clocks of all cameras: one camera after the other joins those whose moments are common."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Int

from fgpose.calibration.from_people.starts.correlation import PEAK_WIDTH_S, Correlation, correlate, peaks
from fgpose.calibration.from_people.starts.epipolar_shift import fit_epipolar_shift
from fgpose.calibration.from_people.starts.motion_signals import MotionSignals
from fgpose.calibration.from_people.starts.views import View
from fgpose.estimation.noise import TELLING_HZ

_MAX_PEAKS = 8
_MIN_PEAK = 0.4  # of the highest one
_MAX_PARTNERS = 3
# Of random signals the highest of a few thousand shifts is about 4.
_MIN_SCORE = 5.0
_DECISIVE = 1.15


@dataclass(frozen=True)
class _Proposal:
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
    best_s: float
    """By the clock of the others: common time = own time + best_s."""
    second_s: float | None
    """The next best."""
    is_outstanding: bool
    """Whether the motion fits better than chance would have it."""
    is_decisive: bool
    """Whether it does, and fits much better than at any other moment."""
    alike_s: tuple[float, ...] = ()
    """Moments that fit nearly as well as the best, by the same clock."""


@dataclass(frozen=True)
class Joining:
    offsets_s: dict[int, float]
    """Of the cameras that could be joined: common time = own time + offset."""
    joined: dict[int, Joined]
    """Of cameras that were tried, also in vain."""


def join_cameras(
    signals: Sequence[MotionSignals], views: Sequence[View], offsets_s: Mapping[int, float] | None = None
) -> Joining:
    """Whole offsets of all cameras that can be joined.

    It begins with the two cameras whose correlation has the most outstanding peak, which is at 0 for the first of them.
    Then always the camera joins whose correlations with all those that have joined, summed up where they are
    consistent, have the most outstanding peak. Which peak is right is decided by how well the joints satisfy an
    epipolar geometry there. A camera for which that is not decisive is tried again when others have joined.

    Args:
        signals, views: of all cameras; empty where nobody is seen.
        offsets_s: of cameras that have joined already.
    """
    pairs = _correlations(signals)
    waiting = [camera for camera in range(len(signals)) if signals[camera].known.any()]
    joining = Joining(dict(offsets_s), {}) if offsets_s else _first_two(waiting, pairs, views)
    if not joining.offsets_s:
        return joining
    waiting = [camera for camera in waiting if camera not in joining.offsets_s]
    postponed: list[int] = []
    while waiting:
        camera = max(waiting, key=lambda camera: _outstanding(_together(camera, joining.offsets_s, pairs)[1]))
        waiting.remove(camera)
        postponed.append(camera)
        joined = _proposed(camera, joining.offsets_s, pairs, views)
        if joined is None:
            continue
        joining.joined[camera] = joined
        if joined.is_decisive:
            joining.offsets_s[camera] = joined.best_s
            waiting, postponed = [*waiting, *(other for other in postponed if other != camera)], []
    return joining


def _first_two(cameras: Sequence[int], pairs: Mapping[tuple[int, int], Correlation], views: Sequence[View]) -> Joining:
    """The two with the most outstanding peak that is decisive; if there are none, how each has failed."""
    failed: dict[int, Joined] = {}
    for one, other in sorted(combinations(cameras, 2), key=lambda pair: -_outstanding(pairs[pair].score)):
        joined = _proposed(other, {one: 0.0}, pairs, views)
        if joined is None:
            continue
        if joined.is_decisive:
            return Joining({one: 0.0, other: joined.best_s}, {other: joined})
        failed.setdefault(other, joined)
        failed.setdefault(one, joined)
    return Joining({}, failed)


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
    known = {one: round(offset_s * TELLING_HZ) for one, offset_s in offsets_s.items()}
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
        _judged(camera, float(offsets[peak]) / TELLING_HZ, float(score[peak]), offsets_s, pairs, views)
        for peak in highest
        if score[peak] >= _MIN_PEAK * score[highest[0]]
    ]
    if not found:
        return None
    best = max(found, key=lambda proposal: proposal.support)
    # Neighbouring peaks may lead to the same moment.
    others = [proposal for proposal in found if abs(proposal.offset_s - best.offset_s) > PEAK_WIDTH_S]
    second = max(others, key=lambda proposal: proposal.support, default=None)
    is_outstanding = best.score >= _MIN_SCORE and best.misfit < 1.0
    is_decisive = is_outstanding and (second is None or best.support >= _DECISIVE * second.support)
    alike_s = tuple(each.offset_s for each in others if best.support < _DECISIVE * each.support)
    second_s = None if second is None else second.offset_s
    return Joined(camera, best.offset_s, second_s, is_outstanding, is_decisive, alike_s)


def _judged(
    camera: int,
    offset_s: float,
    score: float,
    offsets_s: Mapping[int, float],
    pairs: Mapping[tuple[int, int], Correlation],
    views: Sequence[View],
) -> _Proposal:
    """A peak, refined by the epipolar geometries with those that have most in common with the camera then."""

    def in_common(one: int) -> float:
        shift = np.array([round((offset_s - offsets_s[one]) * TELLING_HZ)])
        return float(pairs[one, camera].at(shift)[0])

    partners = sorted(offsets_s, key=in_common, reverse=True)[:_MAX_PARTNERS]
    fits = [fit_epipolar_shift(views[one], views[camera], offset_s - offsets_s[one]) for one in partners]
    known = [(one, fit) for one, fit in zip(partners, fits, strict=True) if fit is not None]
    if not known:
        return _Proposal(offset_s, score, 1.0)
    weight = np.array([fit.n_points for _, fit in known], dtype=float)
    refined_s = [offsets_s[one] + fit.clock.shift_s for one, fit in known]
    misfit = float(np.average([fit.misfit for _, fit in known], weights=weight))
    return _Proposal(float(np.median(refined_s)), score, misfit)
