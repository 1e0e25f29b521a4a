"""Recordings played as if they were cameras: all start together and go on in step."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator

from fgpose.live.cameras.clock_model import Stamp
from fgpose.live.cameras.image import Picture, SourceImage
from fgpose.live.clock import Clock

# Later than this, a recording joins in where the others are when it begins anew.
_OVERDUE_S = 1.0


class Playback:
    """The start and the period that all recordings of a rig share."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._start_s: float | None = None
        self.period_s = 0.0
        """After which looping recordings begin anew: the length of the longest."""

    @property
    def start_s(self) -> float:
        """Unix time of the first images: when this is first asked for."""
        with self._lock:
            if self._start_s is None:
                self._start_s = self._clock.now_s()
            return self._start_s

    def begin(self, start_s: float, period_s: float) -> None:
        """Have the start and the period of recordings in other processes."""
        with self._lock:
            self._start_s, self.period_s = start_s, period_s

    def join(self, duration_s: float) -> None:
        """Tell how long a recording is."""
        with self._lock:
            self.period_s = max(self.period_s, duration_s)

    def play(
        self, frames: Callable[[], Iterable[tuple[float, Picture | None]]], *, in_real_time: bool, loop: bool
    ) -> Iterator[SourceImage]:
        """The images of a recording, stamped with Unix time.

        Args:
            frames: begins anew at each call: seconds since the first image, and the picture; None where it is damaged.
            in_real_time: wait until each is due.
            loop: again and again.
        """
        n_rounds, begin_s = self._position(0, loop=loop) if in_real_time else (0, 0.0)
        while loop or n_rounds == 0:
            is_empty = True
            for since_s, picture in frames():
                is_empty = False
                if since_s < begin_s:
                    continue
                due_s = self.start_s + n_rounds * self.period_s + since_s
                if in_real_time:
                    self._clock.sleep(due_s - self._clock.now_s())
                yield SourceImage(picture, Stamp(due_s, is_host_time=True), is_damaged=picture is None)
            if is_empty:
                return
            n_rounds, begin_s = self._position(n_rounds + 1, loop=loop) if in_real_time else (n_rounds + 1, 0.0)

    def _position(self, n_rounds: int, *, loop: bool) -> tuple[int, float]:
        """Rounds that are over, and where to begin in the next: after so many rounds, or where the others are."""
        elapsed_s = self._clock.now_s() - self.start_s
        if elapsed_s < n_rounds * self.period_s + _OVERDUE_S:
            return n_rounds, 0.0
        n_rounds = int(elapsed_s // self.period_s) if loop and self.period_s else n_rounds
        return n_rounds, elapsed_s - n_rounds * self.period_s
