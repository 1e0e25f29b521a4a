"""What may have changed of a camera; and which of that is chosen."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fgpose.calibration.changes.change import Change, Kind
from fgpose.calibration.changes.clock_changes import ClockFit, score
from fgpose.calibration.changes.credible import NOTICEABLE_FRAMES, WHOLE_FRAMES
from fgpose.calibration.changes.poses.pose_changes import PoseFit

CLEARLY = 1.08
"""A more complicated change must be better by this than a simpler one."""
# By how much the gain of a change counts that is not what losing images does.
_IMPLAUSIBLE = 0.85


class Candidate(NamedTuple):
    """A change of a camera that may be one."""

    change: Change
    fit: ClockFit | PoseFit
    gain: float
    """Of all blocks."""


def chosen_of(candidates: Sequence[Candidate], frame: float) -> Candidate:
    """That which makes most better; of one camera the simplest that is nearly as good.

    Args:
        frame: of the images, in steps of the lags.
    """
    weighed = {id(each): each.gain * (1.0 if _is_plausible(each, frame) else _IMPLAUSIBLE) for each in candidates}
    best = max(candidates, key=lambda each: weighed[id(each)])
    nearly = [
        each
        for each in candidates
        if each.change.camera == best.change.camera
        and each.change.is_of_clock == best.change.is_of_clock
        and weighed[id(each)] * CLEARLY >= weighed[id(best)]
    ]
    # A jump while nobody moves looks like a rate, which some seconds contradict.
    return min(nearly, key=lambda each: (_n_parameters(each, frame), -_merit(each, weighed[id(each)])))


def _merit(candidate: Candidate, gain: float) -> float:
    """Of candidates that are as simple."""
    return score(candidate.fit.gain) if candidate.change.is_of_clock else gain


def _n_parameters(candidate: Candidate, frame: float) -> int:
    """Of the clock or besides the pose: a jump, when it was and what was before it, a rate and an offset."""
    fit, n_of_jumps = candidate.fit, 0
    if isinstance(fit, ClockFit):
        n_of_jumps = 2 * len(fit.firsts) + int(abs(fit.lag[0]) > NOTICEABLE_FRAMES * frame)
    n_of_bump = 1 if isinstance(fit, ClockFit) or fit.end_edges is None else 2
    n = {Kind.OFFSET: 1, Kind.JUMP: n_of_jumps, Kind.RATE: 2, Kind.MOVED: 0, Kind.BUMP: n_of_bump}
    return n[candidate.change.kind]


def _is_plausible(candidate: Candidate, frame: float) -> bool:
    """Lost images are whole ones, and of two cameras the one that lost some is late afterwards."""
    if candidate.change.kind is not Kind.JUMP:
        return True
    assert isinstance(candidate.fit, ClockFit)
    firsts = list(candidate.fit.firsts)
    frames = (candidate.fit.lag[firsts] - candidate.fit.lag[[first - 1 for first in firsts]]) / frame
    return bool((np.abs(frames - np.round(frames)) < WHOLE_FRAMES).all() and (frames > 0).all())
