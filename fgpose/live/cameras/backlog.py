"""Images of a new connection that had waited for it: they come one after the other, whenever they were taken."""

from __future__ import annotations

from collections import deque

# Of so many intervals most must be as long between arrivals as between stamps, about: a pause of the reader is one.
_INTERVALS, _MOST = 5, 3
_SHARE = 0.5
# What waits is read within a second; who sends in bursts is not waited for any longer.
_LASTS_S = 2.0
# Jitter is less.
_WAITED_S = 0.5


class Backlog:
    """Whether the images of a connection still are those that had waited: until stamps and arrivals advance together.
    Of one whose clock is not known yet, nothing else tells an old image from a clock that is behind."""

    def __init__(self) -> None:
        self._first: tuple[float, float] | None = None
        self._last: tuple[float, float] | None = None
        self._together = deque[bool](maxlen=_INTERVALS)
        self.is_over = False
        self.n_images = 0
        """That belonged to it."""
        self.waited_s = 0.0
        """For how much longer the first had waited than the newest has; 0: nothing had waited."""

    def add(self, stamp_s: float, arrived_s: float) -> None:
        """An image has come. The one with which it is over is the first of those that are to be used."""
        if self._first is None or self._last is None:
            self._first = self._last = stamp_s, arrived_s
            self.n_images = 1
            return
        advance_s, elapsed_s = stamp_s - self._last[0], arrived_s - self._last[1]
        self._last = stamp_s, arrived_s
        self._together.append(elapsed_s >= _SHARE * advance_s)
        lasted_s = arrived_s - self._first[1]
        self.is_over = (sum(self._together) >= _MOST and len(self._together) == _INTERVALS) or lasted_s > _LASTS_S
        self.n_images += not self.is_over
        waited_s = stamp_s - self._first[0] - lasted_s
        self.waited_s = waited_s if waited_s > _WAITED_S else 0.0
