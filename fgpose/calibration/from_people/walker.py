"""The one person on whom cameras are calibrated: in each camera a track, of the same person as far as can be told."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np

from fgpose.calibration.from_people.body_size import mean_joint, steady_radius
from fgpose.calibration.from_people.correlation import correlate
from fgpose.calibration.from_people.motion_signals import MotionSignals, motion_signals
from fgpose.calibration.from_people.tracks import chained, no_track
from fgpose.calibration.from_people.walk import Track
from fgpose.skeleton import Skeleton

# Those seen less are passers-by; each candidate is correlated with those of all other cameras.
_MAX_CANDIDATES = 4
# How much better than that of the next one a track has to fit.
_DECISIVE = 1.3
# Scores of tracks that have nothing in common are seldom above this (in robust standard deviations of chance).
_MIN_SCORE = 4.0
# Somebody who stands still tells a tenth of what a walker at one radius of the body per second does.
_STILL = 0.1


def main_tracks(tracks: Mapping[str, Sequence[Track]], skeleton: Skeleton) -> tuple[Track, ...]:
    """Of each camera the track of the walker, in the order of the cameras; an empty one where nobody is seen.

    A camera that never shows two people at once shows one person, all its tracks are chained. Of several people the one
    is chosen who is seen most: by the time, the number of joints and how much they move. The camera that sees somebody
    best decides who it is; another camera's track of the same person moves at the same moments (correlation.py). Where
    no track fits much better than the others, it is the one that is seen most.
    """
    candidates = {name: _candidates(own) for name, own in tracks.items()}
    best = max(candidates, key=lambda name: max(map(_seen, candidates[name]), default=0.0), default=None)
    if best is None or not candidates[best]:
        return tuple(no_track(name, skeleton) for name in tracks)
    leader = motion_signals(candidates[best][0], skeleton)
    return tuple(
        _same_person(leader, own, skeleton) if own else no_track(name, skeleton) for name, own in candidates.items()
    )


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
    weight = _STILL + np.minimum(np.nan_to_num(speed), 1.0)
    return float(np.sum(track.confidence[1:].mean(axis=1) * step_s * weight))


def _same_person(leader: MotionSignals, candidates: Sequence[Track], skeleton: Skeleton) -> Track:
    """The track that fits best, if that is decisive; else the first."""
    if len(candidates) == 1:
        return candidates[0]
    scores = [correlate(leader, motion_signals(track, skeleton)).score.max() for track in candidates]
    order = np.argsort(scores)[::-1]
    decisive = scores[order[0]] >= max(_MIN_SCORE, _DECISIVE * scores[order[1]])
    return candidates[int(order[0])] if decisive else candidates[0]
