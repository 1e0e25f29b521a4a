"""When a person is there, and when nobody is: nothing is estimated of somebody who has left.

A person whom no camera sees is predicted, as long as they can hardly have gone anywhere else. After tracking.coast_s
(1 s: a step, or half a turn) they are taken to have left, as several people are: they may be anywhere, or come back as
somebody else.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

MIN_JOINTS = 4
"""Fewer do not tell a body from some wrong detections."""
# Somebody who was not seen for a moment and is farther away than people run is somebody else.
_AWAY_S, _NEAR_M, _RUNS_MPS = 0.2, 0.5, 6.0
# In so long somebody may have taken a place. Where bones are forgotten after 0.3 s in which nothing is detected, as a
# short occlusion of everything is, errors are 1 to 11 % larger.
_ELSE_S = 0.5


def present(
    seen: Bool[np.ndarray, " frame"],
    located: Bool[np.ndarray, " frame"],
    time_s: Float[np.ndarray, " frame"],
    coast_s: float,
) -> Bool[np.ndarray, " frame"]:
    """The frames in which a person is there.

    A stay lasts from the first to the last of sightings that are not farther apart than coast_s. Where no joint is ever
    located in it, one camera alone believes in somebody: that tells neither where they are nor that there is anybody.

    Args:
        seen: whether some camera sees the person.
        located: whether two cameras do, or one that tells how far they are.
        time_s: of each frame, increasing.
        coast_s: how long a person is predicted whom no camera sees.
    """
    here = np.zeros(len(time_s), dtype=bool)
    sightings = np.flatnonzero(seen)
    ends = np.flatnonzero(np.diff(time_s[sightings]) > coast_s) + 1
    for stay in np.split(sightings, ends):
        if located[stay].any():
            here[stay[0] : stay[-1] + 1] = True
    return here


class Returns:
    """Of somebody whom no camera detected for a moment, by frames that show nobody: they may be somebody else."""

    def __init__(self) -> None:
        self._detected_s, self._shows_nobody = np.inf, False

    def is_one(self, detected: Bool[np.ndarray, "camera joint"], time_s: float) -> bool:
        """Whether somebody comes with the newest frame, or with another image of it."""
        if np.count_nonzero(detected.any(axis=0)) < MIN_JOINTS:
            self._shows_nobody = True
            return False
        comes = self._shows_nobody and time_s - self._detected_s >= _ELSE_S
        self._detected_s, self._shows_nobody = time_s, False
        return comes


def has_left(
    before_m: Float[np.ndarray, "joint 3"], now_m: Float[np.ndarray, "joint 3"], unseen_s: float, coast_s: float
) -> bool:
    """Whether a person has gone: not seen for too long, or not seen for a moment, and now somebody is where nobody runs
    meanwhile.

    Args:
        before_m: the joints when the person was seen last; NaN: unknown.
        now_m: what is triangulated now.
        unseen_s: how long ago that was.
        coast_s: how long a person is predicted whom no camera sees.
    """
    if unseen_s > coast_s:
        return True
    both = np.isfinite(before_m).all(axis=-1) & np.isfinite(now_m).all(axis=-1)
    if unseen_s < _AWAY_S or np.count_nonzero(both) < MIN_JOINTS:
        return False
    moved_m = np.median(now_m[both], axis=0) - np.median(before_m[both], axis=0)
    return bool(np.linalg.norm(moved_m) > _NEAR_M + _RUNS_MPS * unseen_s)
