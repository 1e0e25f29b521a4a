"""How old the newest image usually is when a frame tells of it first."""

from __future__ import annotations

import logging
from collections import deque

import numpy as np

_LOG = logging.getLogger("fgpose.live")
# Of so many images, as they come: two seconds at 30 Hz.
_REMEMBERED = 60
# Nine of ten come so early; one that is much later than the others does not count.
_SHARE = 0.9
# So many intervals later still, images stay away.
_INTERVALS = 3.0
# Images of most systems come earlier than this. One that is later is no sign of anything; that all are is said.
_MOST_S = 0.2


class UsualAge:
    """Learns how old images are when they are told, and how long after each other they are taken."""

    def __init__(self) -> None:
        self._newest_s = -np.inf
        self._ages_s: deque[float] = deque(maxlen=_REMEMBERED)
        self._intervals_s: deque[float] = deque(maxlen=_REMEMBERED)
        self._is_said = False

    def add(self, newest_s: float, now_s: float) -> None:
        """A frame is published whose newest image was taken at a time; -inf: there was none."""
        if newest_s <= self._newest_s:
            return
        if np.isfinite(self._newest_s):
            self._intervals_s.append(newest_s - self._newest_s)
        self._newest_s = newest_s
        self._ages_s.append(now_s - newest_s)
        self._say(float(np.median(self._ages_s)))

    @property
    def longest_s(self) -> float:
        """When the newest image is older than this, images stay away."""
        if not self._intervals_s:
            return max([_MOST_S, *self._ages_s])
        interval_s = float(np.median(self._intervals_s))
        return max(_MOST_S, float(np.quantile(self._ages_s, _SHARE)) + _INTERVALS * interval_s)

    def _say(self, usual_s: float) -> None:
        if len(self._ages_s) == _REMEMBERED and usual_s > _MOST_S and not self._is_said:
            self._is_said = True
            _LOG.warning(
                "frames come %.2f s after their images were taken (median): people are where they were then (time_s). "
                "Cameras or the network are slow, or this computer is busy",
                usual_s,
            )
