"""How fast people and links come nearer to each other, from one image to the next."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.live.frame import LiveFrame
from fgpose.robot.body import RADIUS_M

# Between images of 30 Hz an error of 1 cm makes 0.4 m/s; over this time 0.14 m/s.
_OVER_S = 0.1
_REMEMBERED_S = 1.0


@dataclass(frozen=True, eq=False)
class _Seen:
    """Everybody in a frame, and how far they were expected to be from each link."""

    time_s: float
    joints_m: Float[np.ndarray, "person joint 3"]
    expected_m: Float[np.ndarray, "person link"]


class Approach:
    """Closing speeds over the last 0.1 s or a little more.

    Who was where is told by place, not by number, so that it does not matter whether somebody's number has changed or
    two people have exchanged theirs: the body of then that is nearest to somebody now is taken, if they can have walked
    from there. Bodies are farther apart than they walk in that time.

    Args:
        walking_m_s: how fast people walk.
    """

    def __init__(self, walking_m_s: float) -> None:
        self._walking_m_s = walking_m_s
        self._seen: deque[_Seen] = deque()
        self._newest: LiveFrame | None = None

    def add(self, frame: LiveFrame, expected_m: Float[np.ndarray, "person link"]) -> None:
        """A frame with the distances of its people from the links. One that is known already adds nothing; another one
        of the same time, as after a tracker has failed, takes its place."""
        if frame is self._newest:
            return
        self._newest = frame
        if self._seen and frame.time_s == self._seen[-1].time_s:
            self._seen.pop()
        if self._seen and frame.time_s < self._seen[-1].time_s:
            self._seen.clear()
        joints_m = np.array([person.positions_m for person in frame.people]).reshape(-1, frame.skeleton.n_joints, 3)
        self._seen.append(_Seen(frame.time_s, joints_m, expected_m))
        while self._seen[0].time_s < frame.time_s - _REMEMBERED_S:
            self._seen.popleft()

    def closing_m_s(self, person: int, link: int) -> float:
        """Of somebody of the newest frame, by index, and a link; NaN if nobody was near their place before."""
        now = self._seen[-1]
        # A hundredth of an image of 100 Hz: times are not exact multiples.
        before = next((seen for seen in reversed(self._seen) if seen.time_s <= now.time_s - _OVER_S + 1e-4), None)
        if before is None:
            return math.nan
        moved_m = np.linalg.norm(before.joints_m - now.joints_m[person], axis=-1)
        common = np.isfinite(moved_m)
        mean_m = np.where(common, moved_m, 0.0).sum(axis=1) / np.maximum(common.sum(axis=1), 1)
        mean_m[~common.any(axis=1)] = np.inf
        elapsed_s = now.time_s - before.time_s
        # Two bodies are at least a trunk apart.
        if not len(mean_m) or mean_m.min() > self._walking_m_s * elapsed_s + 2 * RADIUS_M["trunk"]:
            return math.nan
        change_m = before.expected_m[int(np.argmin(mean_m)), link] - now.expected_m[person, link]
        return float(change_m / elapsed_s) if math.isfinite(change_m) else math.nan
