"""The one person on whom cameras are calibrated: in each camera a track, of the same person as far as can be told."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int

from fgpose.calibration.from_people.body_size import STANDING, mean_joint, steady_radius
from fgpose.calibration.from_people.starts.correlation import Correlation, correlate, peaks
from fgpose.calibration.from_people.starts.motion_signals import MotionSignals, motion_signals
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


def main_tracks(
    tracks: Mapping[str, Sequence[Track]], skeleton: Skeleton, *, synchronised: bool = False
) -> tuple[Track, ...]:
    """Of each camera the track of the walker, in the order of the cameras; an empty one where nobody is seen.

    A camera that never shows two people at once shows one person, all its tracks are chained. Of several people the one
    is chosen who is seen most: by the time, the number of joints and how much they move. The camera that sees somebody
    best decides who it is; another camera's tracks of the same person move at the same moments (correlation.py), all of
    them with one shift between the clocks. Where none fit much better than the others, it is the one that is seen most.

    Args:
        tracks: of each camera, everybody.
        skeleton: of all.
        synchronised: whether the clocks of the cameras are one.
    """
    candidates = {name: _candidates(own) for name, own in tracks.items()}
    best = max(candidates, key=lambda name: max(map(_seen, candidates[name]), default=0.0), default=None)
    if best is None or not candidates[best]:
        return tuple(no_track(name, skeleton) for name in tracks)
    leader = motion_signals(candidates[best][0], skeleton)

    def walker(name: str) -> Track:
        if not candidates[name]:
            return no_track(name, skeleton)
        return candidates[name][0] if name == best else _same_person(leader, candidates[name], skeleton, synchronised)

    return tuple(walker(name) for name in candidates)


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


def _same_person(leader: MotionSignals, candidates: Sequence[Track], skeleton: Skeleton, synchronised: bool) -> Track:
    """The tracks that fit best, if that is decisive; else the one that is seen most."""
    if len(candidates) == 1:
        return candidates[0]
    correlations = [correlate(leader, motion_signals(track, skeleton)) for track in candidates]
    moments = [np.zeros(1, dtype=int)] if synchronised else [_peaks(own) for own in correlations]
    fits = [
        np.array([own.at(moment + _AROUND).max() for own in correlations])
        for moment in np.unique(np.concatenate(moments)).tolist()
    ]
    chosen, score = max((_chain(candidates, fit) for fit in fits), key=lambda chain: chain[1])
    is_chosen = np.isin(np.arange(len(candidates)), chosen)
    rival = max(_chain(candidates, np.where(is_chosen, -np.inf, fit))[1] for fit in fits)
    if score < max(_MIN_SCORE_AT if synchronised else _MIN_SCORE, _DECISIVE * rival):
        return candidates[0]
    return chained([candidates[track] for track in chosen])


def _peaks(correlation: Correlation) -> Int[np.ndarray, " peak"]:
    return correlation.shifts[peaks(correlation.score, _N_PEAKS)]


def _chain(tracks: Sequence[Track], scores: Float[np.ndarray, " track"]) -> tuple[tuple[int, ...], float]:
    """Tracks that fit at one moment and are not seen at once, the best first, and how well they fit together."""
    chain: list[int] = []
    for track in np.argsort(-scores).tolist():
        if scores[track] >= _MIN_SCORE_AT and not any(_at_once(tracks[track], tracks[other]) for other in chain):
            chain.append(track)
    return tuple(chain), float(np.linalg.norm(scores[chain]))


def _at_once(one: Track, other: Track) -> bool:
    return bool(one.time_s[0] <= other.time_s[-1] and other.time_s[0] <= one.time_s[-1])
