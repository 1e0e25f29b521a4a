"""What happens when, in simulated time."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable

from fgpose.io.live.recordings import RecordedImage
from fgpose.live.clock import SimulatedClock
from fgpose.live.processes.pending_detections import PendingDetections


class Timeline:
    """Lets things happen at their times, one after the other.

    Args:
        clock: which it advances.
    """

    def __init__(self, clock: SimulatedClock) -> None:
        self.clock = clock
        self._coming: list[tuple[float, int, Callable[[], None]]] = []
        self._order = itertools.count()

    def at(self, time_s: float, do: Callable[[], None]) -> None:
        """Let something happen at a Unix time, or next if that is past."""
        heapq.heappush(self._coming, (time_s, next(self._order), do))

    def advance(self, until_s: float, is_enough: Callable[[], bool] = lambda: False) -> None:
        """Let everything happen up to a Unix time, or until it is enough."""
        while not is_enough():
            self.clock.advance(max(min(until_s, self._coming[0][0]) - self.clock.now_s(), 0.0))
            while self._coming[0][0] <= self.clock.now_s():
                heapq.heappop(self._coming)[2]()
            if self.clock.now_s() >= until_s:
                return

    def until_any(self, arrivals: PendingDetections, timeout_s: float) -> list[RecordedImage]:
        """Let everything happen until an image arrives, or for a time: those that have."""
        self.advance(self.clock.now_s() + timeout_s, arrivals.is_any)
        return arrivals.take(0.0)

    def pause(self, duration_s: float) -> None:
        """Nothing happens for a while; what should have, does next."""
        self.clock.advance(duration_s)
