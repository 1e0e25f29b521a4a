"""A thread whose work goes on."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from contextlib import suppress

from fgpose.live.processes.parts import Parts

# Before work begins again: doubled from the first to the last, and the first again when it has gone well for so long.
_FIRST_WAIT_S, _LAST_WAIT_S, _WORKS_S = 0.05, 2.0, 10.0
HANGS_S = 2.0
"""Work that is never that long without asking whether it is to stop hangs if it is."""
# Between two looks; what is more nobody has looked, as while this process was stopped.
_LOOKS_S = 0.2


class PartEndedError(Exception):
    """What work raises where it knows what has ended, and why: there is nothing to be found in the code."""


class Stop(threading.Event):
    """Set when work is to stop. Who asks whether it is does not hang."""

    n_asked = 0
    is_waiting = False

    def is_set(self) -> bool:
        self.n_asked += 1
        return super().is_set()

    def wait(self, timeout: float | None = None) -> bool:
        self.is_waiting = True
        try:
            return super().wait(timeout)
        finally:
            self.is_waiting = False
            self.n_asked += 1


class Worker:
    """Does its work in a thread until it is closed. Work that ends before, however it does, is begun again and counted:
    after 0.05 s, and where it ends again and again after twice as long each time, up to 2 s, which is said.

    Args:
        name: of the part of the live system, for people.
        work: returns soon when ``stopped`` is set.
        parts: told when the work has ended before, or hangs.
        hangs_after_s: without asking whether it is to stop, as somebody finds out who calls ``look`` of the parts.
        is_replaced: what hangs is left behind, and begun again in another thread; when it goes on, it is to stop.
    """

    def __init__(
        self,
        name: str,
        work: Callable[[], None],
        parts: Parts | None = None,
        *,
        hangs_after_s: float = math.inf,
        is_replaced: bool = False,
    ) -> None:
        self._name, self._work, self._parts = name, work, parts or Parts()
        self._hangs_after_s, self._is_replaced = hangs_after_s, is_replaced
        self._of_thread = threading.local()
        self._n_asked, self._silent_s, self._is_said = -1, 0.0, False
        self._new_thread()

    @property
    def stopped(self) -> Stop:
        """To the thread that asks: one that was left behind is to stop."""
        return getattr(self._of_thread, "stopped", self._stopped)

    def _new_thread(self) -> None:
        self._stopped = Stop()
        self._thread = threading.Thread(
            target=self._run, args=(self._stopped,), name=f"fgpose {self._name}", daemon=True
        )

    def start(self) -> None:
        """Begin."""
        self._thread.start()
        if math.isfinite(self._hangs_after_s):
            self._parts.watch(self.look)

    @property
    def is_alive(self) -> bool:
        return self._thread.is_alive()

    def close(self, timeout_s: float | None = None) -> None:
        """Stop the work and wait until it has, or for a time. Closing again does nothing."""
        self._stopped.set()
        if self._thread.is_alive():
            self._thread.join(timeout_s)

    def look(self, elapsed_s: float) -> None:
        """Find out whether it hangs. To be called several times a second.

        Args:
            elapsed_s: since the last time.
        """
        stopped = self._stopped
        if stopped.is_waiting or stopped.n_asked != self._n_asked:
            self._n_asked, self._silent_s, self._is_said = stopped.n_asked, 0.0, False
            return
        self._silent_s += min(elapsed_s, _LOOKS_S)
        if self._silent_s < self._hangs_after_s or self._is_said or not self.is_alive:
            return
        self._is_said, reason = True, f"it hangs: nothing for {self._silent_s:.1f} s"
        if not self._is_replaced:
            self._parts.hangs(self._name, reason)
            return
        stopped.set()
        self._new_thread()
        self._thread.start()
        self._parts.restarted(self._name, reason)

    def _run(self, stopped: Stop) -> None:
        self._of_thread.stopped = stopped
        wait_s = _FIRST_WAIT_S
        # At least once more when it is to be closed: it may have something to write to its end.
        while True:
            began_s, error = time.monotonic(), None
            try:
                self._work()
            # Whatever ends it, SystemExit of a library too.
            except BaseException as raised:
                error = raised
            if stopped.is_set():
                return
            wait_s = _FIRST_WAIT_S if time.monotonic() - began_s > _WORKS_S else wait_s
            with suppress(Exception):  # whoever is told must not end it either
                if error is None or isinstance(error, PartEndedError):
                    self._parts.restarted(self._name, str(error or "its work returned"), wait_s=wait_s)
                else:
                    self._parts.restarted(self._name, f"{type(error).__name__}: {error}", error, wait_s=wait_s)
            stopped.wait(wait_s)
            wait_s = min(2 * wait_s, _LAST_WAIT_S)
