"""The one clock of a live system."""

from __future__ import annotations

import time

FUTURE_S = 0.1
"""By which clocks of computers in one room may differ; what is dated farther ahead has a wrong clock."""


class Clock:
    """Unix time that never jumps: the monotonic clock, set once.

    It follows the rate of the computer's clock, which NTP disciplines, but not steps that are made while it runs.

    Args:
        unix_minus_monotonic_s: of another clock of this computer, with which it shall agree; None: it is set now.
    """

    def __init__(self, unix_minus_monotonic_s: float | None = None) -> None:
        is_set = unix_minus_monotonic_s is not None
        self.unix_minus_monotonic_s = unix_minus_monotonic_s if is_set else time.time() - time.monotonic()

    def now_s(self) -> float:
        return time.monotonic() + self.unix_minus_monotonic_s

    def sleep(self, duration_s: float) -> None:
        time.sleep(max(duration_s, 0.0))


class SimulatedClock(Clock):
    """A clock that stands still but for advance and sleep, for simulations in one thread."""

    def __init__(self, start_s: float = 0.0) -> None:
        super().__init__()
        self._now_s = start_s

    def now_s(self) -> float:
        return self._now_s

    def advance(self, duration_s: float) -> None:
        """Raises ValueError where the duration is negative."""
        if duration_s < 0:
            raise ValueError(f"a clock does not go back: {duration_s} s")
        self._now_s += duration_s

    def sleep(self, duration_s: float) -> None:
        self.advance(max(duration_s, 0.0))
