"""A thread whose work goes on."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import suppress

from fgpose.live.parts import Parts

# Before work begins again: doubled from the first to the last, and the first again when it has gone well for so long.
_FIRST_WAIT_S, _LAST_WAIT_S, _WORKS_S = 0.05, 2.0, 10.0


class PartEndedError(Exception):
    """What work raises where it knows what has ended, and why: there is nothing to be found in the code."""


class Worker:
    """Does its work in a thread until it is closed. Work that ends before, however it does, is begun again and counted:
    after 0.05 s, and where it ends again and again after twice as long each time, up to 2 s, which is said.

    Args:
        name: of the part of the live system, for people.
        work: returns soon when ``stopped`` is set.
        parts: told when the work has ended before.
    """

    def __init__(self, name: str, work: Callable[[], None], parts: Parts | None = None) -> None:
        self._name, self._work, self._parts = name, work, parts or Parts()
        self.stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"fgpose {name}", daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    @property
    def is_alive(self) -> bool:
        return self._thread.is_alive()

    def close(self, timeout_s: float | None = None) -> None:
        """Stop the work and wait until it has, or for a time. Closing again does nothing."""
        self.stopped.set()
        if self._thread.is_alive():
            self._thread.join(timeout_s)

    def _run(self) -> None:
        wait_s = _FIRST_WAIT_S
        # At least once more when it is to be closed: it may have something to write to its end.
        while True:
            began_s, error = time.monotonic(), None
            try:
                self._work()
            # Whatever ends it, SystemExit of a library too.
            except BaseException as raised:
                error = raised
            if self.stopped.is_set():
                return
            wait_s = _FIRST_WAIT_S if time.monotonic() - began_s > _WORKS_S else wait_s
            with suppress(Exception):  # whoever is told must not end it either
                if error is None or isinstance(error, PartEndedError):
                    self._parts.restarted(self._name, str(error or "its work returned"), wait_s=wait_s)
                else:
                    self._parts.restarted(self._name, f"{type(error).__name__}: {error}", error, wait_s=wait_s)
            self.stopped.wait(wait_s)
            wait_s = min(2 * wait_s, _LAST_WAIT_S)
