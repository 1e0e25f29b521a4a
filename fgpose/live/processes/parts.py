"""The threads and processes of a live system: what of it has ended and was begun again, said and counted."""

from __future__ import annotations

import logging
import math
import threading
import time
import weakref
from collections.abc import Callable

from fgpose.live.frame import Restarts

_LOG = logging.getLogger("fgpose.live")
# What fails again and again in the same way is said so often.
_AGAIN_S = 10.0
# A wait that nobody notices.
_AT_ONCE_S = 0.1


class Parts:
    """Counts restarts. Any thread may use it.

    Args:
        now_s: Unix time.
        note: told of each restart that is said, in a line.
        on_restart: told of every restart, as it is counted so far.
    """

    def __init__(
        self,
        now_s: Callable[[], float] = time.time,
        note: Callable[[str], None] = lambda line: None,
        on_restart: Callable[[Restarts], None] = lambda restarts: None,
    ) -> None:
        self._now_s, self._note, self._on_restart = now_s, note, on_restart
        self._restarts: dict[str, Restarts] = {}
        self._said: dict[str, tuple[float, str]] = {}
        self._looks: list[weakref.WeakMethod[Callable[[float], None]]] = []
        self._looked_s = time.monotonic()
        self._lock = threading.Lock()

    def restarted(self, part: str, reason: str, error: BaseException | None = None, wait_s: float = 0.0) -> None:
        """A part has ended, for a reason or with an error, and is begun again after a time."""
        line = self._news(self.count(part, reason), wait_s)
        if line:
            _LOG.warning("%s", line, exc_info=error)
            self._note(line)

    def hangs(self, part: str, reason: str) -> None:
        """A part does nothing, for a reason, and cannot be begun again."""
        line = f"{part} is not well ({reason})"
        _LOG.warning("%s", line)
        self._note(line)

    def watch(self, look: Callable[[float], None]) -> None:
        """Let a method be called at every look, with the seconds since the one before, as long as its object lives."""
        with self._lock:
            self._looks.append(weakref.WeakMethod(look))

    def look(self) -> None:
        """Find out what hangs. To be called several times a second, from one thread."""
        now_s = time.monotonic()
        elapsed_s, self._looked_s = now_s - self._looked_s, now_s
        with self._lock:
            self._looks = [each for each in self._looks if each() is not None]
            looks = list(self._looks)
        for each in looks:
            if (look := each()) is not None:
                look(elapsed_s)

    def heard(self, restarts: Restarts) -> None:
        """A part of another process has, which has logged it."""
        line = self._news(self.count(restarts.part, restarts.reason))
        if line:
            self._note(line)

    def count(self, part: str, reason: str) -> Restarts:
        """A part has, which somebody else says."""
        with self._lock:
            n = self._restarts[part].n if part in self._restarts else 0
            restarts = self._restarts[part] = Restarts(part, n + 1, reason, self._now_s())
        self._on_restart(restarts)
        return restarts

    def _news(self, restarts: Restarts, wait_s: float = 0.0) -> str:
        """What is to be said; empty: it was said a moment ago."""
        said_s, said = self._said.get(restarts.part, (-math.inf, ""))
        if restarts.reason == said and restarts.last_s < said_s + _AGAIN_S:
            return ""
        self._said[restarts.part] = restarts.last_s, restarts.reason
        when = f" in {wait_s:g} s" if wait_s > _AT_ONCE_S else ""
        return f"{restarts.part} ended ({restarts.reason}) and is begun again{when}; {restarts.n} times so far"

    def so_far(self) -> tuple[Restarts, ...]:
        """Of the parts that have ended at least once."""
        with self._lock:
            return tuple(self._restarts.values())
