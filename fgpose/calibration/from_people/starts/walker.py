"""The one person on whom cameras are calibrated: in each camera a track, of the same person as far as can be told."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from fgpose.calibration.from_people.body_size import STANDING, mean_joint, steady_radius
from fgpose.calibration.from_people.starts.correlation import Correlation, correlate, peaks
from fgpose.calibration.from_people.starts.motion_signals import motion_signals
from fgpose.calibration.from_people.tracks import chained, no_track
from fgpose.calibration.from_people.walk import Track
from fgpose.skeleton import Skeleton

# Those seen less are passers-by; each candidate is correlated with those of all other cameras.
_MAX_CANDIDATES = 8
# How much better than those of somebody else the tracks of one person have to fit.
_DECISIVE = 1.3
# Scores of tracks that have nothing in common are seldom above this (in robust standard deviations of chance).
_MIN_SCORE = 4.0
# At a moment that is known, or on which several tracks agree, chance has one try instead of some hundred.
_MIN_SCORE_AT = 2.0
# So many samples around a known moment: images of synchronised cameras are up to half an interval apart.
_AROUND = np.arange(-1, 2)
_N_PEAKS = 3
Compare = Callable[[Track, Track], Correlation]
"""How well two tracks fit at every shift between their clocks."""


def main_tracks(
    tracks: Mapping[str, Sequence[Track]],
    skeleton: Skeleton,
    *,
    synchronised: bool = False,
    compare: Compare | None = None,
) -> tuple[Track, ...]:
    """Of each camera the track of the walker, in the order of the cameras; an empty one where nobody is seen.

    A camera that never shows two people at once shows one person, all its tracks are chained. Of several people the one
    is chosen who is seen most: by the time, the number of joints and how much they move. The camera that sees somebody
    best decides who it is; another camera's tracks of the same person fit its track (correlation.py, or the epipolar
    geometry where that is known), all of them with one shift between the clocks. Where none fit much better than the
    others, it is the one that is seen most.

    Args:
        tracks: of each camera, everybody.
        skeleton: of all.
        synchronised: whether the clocks of the cameras are one.
        compare: how tracks are compared; None: by whether they move at the same moments.
    """
    if compare is None:
        signals = cache(partial(motion_signals, skeleton=skeleton))
        compare = lambda one, other: correlate(signals(one), signals(other))  # noqa: E731
    candidates = {name: _candidates(own) for name, own in tracks.items()}
    walkers = {name: own[0] if own else no_track(name, skeleton) for name, own in candidates.items()}
    best = max(candidates, key=lambda name: max(map(_seen, candidates[name]), default=0.0), default=None)
    if best is None or all(len(own) < 2 for own in candidates.values()):
        return tuple(walkers.values())
    found = {best: _Found(walkers[best], 0)}
    waiting = {name: own for name, own in candidates.items() if own and name != best}
    same_person = partial(_same_person, compare=cache(compare), synchronised=synchronised)
    # Whom the camera that sees best does not tell apart, several may.
    while more := {name: each for name, own in waiting.items() if (each := same_person([*found.values()], own))}:
        found |= more
        waiting = {name: own for name, own in waiting.items() if name not in found}
    return tuple((walkers | {name: each.track for name, each in found.items()}).values())


@dataclass(frozen=True, eq=False)
class _Found:
    """Somebody's track in one camera."""

    track: Track
    shift: int
    """Of the clock of the camera, in samples: common = own + shift."""


def _candidates(tracks: Sequence[Track]) -> list[Track]:
    """Those who are seen most, first the best; one if no two are seen at once."""
    if not tracks:
        return []
    if not _any_at_once(tracks):
        return [chained(tracks)]
    return sorted(tracks, key=_seen, reverse=True)[:_MAX_CANDIDATES]


def _any_at_once(tracks: Sequence[Track]) -> bool:
    ordered = sorted(tracks, key=lambda track: track.time_s[0])
    return any(second.time_s[0] <= first.time_s[-1] for first, second in pairwise(ordered))


def _seen(track: Track) -> float:
    """Joint-seconds that are seen, those of somebody who moves more."""
    if len(track.time_s) < 2:
        return 0.0
    step_s = np.minimum(np.diff(track.time_s), 0.2)
    radius_px = steady_radius(track.time_s, track.points2d_px)[1:]
    # Of the body as a whole: the noise of single joints is no motion.
    centre_px = mean_joint(track.points2d_px)
    speed = np.linalg.norm(np.diff(centre_px, axis=0), axis=-1) / radius_px / np.diff(track.time_s)
    weight = STANDING + np.minimum(np.nan_to_num(speed), 1.0)
    return float(np.sum(track.confidence[1:].mean(axis=1) * step_s * weight))


def _same_person(
    found: Sequence[_Found], candidates: Sequence[Track], compare: Compare, synchronised: bool
) -> _Found | None:
    """The tracks that fit best those of other cameras; None if that is not decisive."""
    compared = [(other.shift, [compare(other.track, track) for track in candidates]) for other in found]
    moments = {0} if synchronised else {shift + peak for shift, row in compared for own in row for peak in _peaks(own)}

    def fit(moment: int) -> Float[np.ndarray, " track"]:
        at = [[own.at(moment - shift + _AROUND).max() for own in row] for shift, row in compared]
        # By chance of unit variance, like each of them.
        return np.sum(at, axis=0) / np.sqrt(len(found))

    fits = {moment: fit(moment) for moment in sorted(moments)}
    chosen, score, moment = max(
        ((*_chain(candidates, each), moment) for moment, each in fits.items()),
        key=lambda chain: chain[1],
        default=((), 0.0, 0),
    )
    is_chosen = np.isin(np.arange(len(candidates)), chosen)
    rival = max((_chain(candidates, np.where(is_chosen, -np.inf, each))[1] for each in fits.values()), default=0.0)
    if score < max(_MIN_SCORE_AT if synchronised else _MIN_SCORE, _DECISIVE * rival):
        return None
    return _Found(chained([candidates[track] for track in chosen]), moment)


def _peaks(correlation: Correlation) -> list[int]:
    return correlation.shifts[peaks(correlation.score, _N_PEAKS)].tolist()


def _chain(tracks: Sequence[Track], scores: Float[np.ndarray, " track"]) -> tuple[tuple[int, ...], float]:
    """Tracks that fit at one moment and are not seen at once, the best first, and how well they fit together."""
    chain: list[int] = []
    for track in np.argsort(-scores).tolist():
        if scores[track] >= _MIN_SCORE_AT and not any(_at_once(tracks[track], tracks[other]) for other in chain):
            chain.append(track)
    return tuple(chain), float(np.linalg.norm(scores[chain]))


def _at_once(one: Track, other: Track) -> bool:
    return bool(one.time_s[0] <= other.time_s[-1] and other.time_s[0] <= one.time_s[-1])
