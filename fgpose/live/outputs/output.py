"""What takes the frames of a live system, and how it is kept from holding the others up."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from fgpose.live.frame import LiveFrame

# A consumer that has not taken a frame after this time does not work.
_HUNG_S = 0.8
_CLOSE_S = 2.0


@dataclass(frozen=True)
class OutputState:
    """Of an output, to be shown."""

    name: str
    is_working: bool
    n_published: int
    """Frames that were passed on."""
    n_skipped: int
    """Frames that were not: a newer one came first, or passing them on failed."""
    last_error: str = ""
    """Why it did not work when it last did not; empty: it always has."""
    n_lost: int = 0
    """Of a file: what is missing in it although it should be there, and will stay so."""


@runtime_checkable
class Output(Protocol):
    """Takes frames. Nothing here waits for a consumer, or raises because of one."""

    @property
    def state(self) -> OutputState: ...

    def publish(self, frame: LiveFrame) -> None:
        """Take the newest frame."""
        ...

    def close(self) -> None:
        """Let go of everything; closing again does nothing."""
        ...


@runtime_checkable
class Sink(Protocol):
    """Passes frames on. It may wait and raise."""

    def send(self, frame: LiveFrame) -> None: ...

    def close(self) -> None: ...


class BackgroundOutput:
    """Any sink as an output: it works in a thread of its own, which takes the newest frame whenever it is ready or, for
    files, the oldest of a few that wait.

    A sink that raises is closed and opened again, after a pause that doubles each time.

    Args:
        name: for people.
        open_sink: opens the sink. It is opened first before this returns, so that what is wrong from the start (a port
            that is taken) is raised here.
        n_waiting: frames that may wait for the sink; beyond that the oldest are skipped.
        tell: called with one line when the output stops working, and when it works again.
        first_retry_s: the first pause.
        longest_retry_s: the longest.
        close_s: closing waits so long for a frame on its way and for the sink; then they are left behind.

    Raises:
        Exception: whatever open_sink raises.
    """

    def __init__(
        self,
        name: str,
        open_sink: Callable[[], Sink],
        *,
        n_waiting: int = 1,
        tell: Callable[[str], None] | None = None,
        first_retry_s: float = 0.5,
        longest_retry_s: float = 30.0,
        close_s: float = _CLOSE_S,
    ) -> None:
        self.name = name
        self._open_sink, self._tell = open_sink, tell
        self._retry_s, self._close_s = (first_retry_s, longest_retry_s), close_s
        self._sink: Sink | None = open_sink()
        self._changed = threading.Condition()
        self._waiting: deque[LiveFrame] = deque(maxlen=n_waiting)
        self._is_closed = False
        self._n_published = self._n_skipped = 0
        self._is_failing, self._last_error = False, ""
        self._sending_since_s: float | None = None
        self._thread = threading.Thread(target=self._run, name=f"fgpose output {name}", daemon=True)
        self._thread.start()

    @property
    def state(self) -> OutputState:
        since_s = self._sending_since_s
        if since_s is not None and time.monotonic() - since_s > _HUNG_S:
            hung = f"it has not taken a frame for {time.monotonic() - since_s:.0f} s"
            return OutputState(self.name, False, self._n_published, self._n_skipped, hung)
        return OutputState(self.name, not self._is_failing, self._n_published, self._n_skipped, self._last_error)

    def publish(self, frame: LiveFrame) -> None:
        with self._changed:
            if self._is_closed:
                return
            self._n_skipped += len(self._waiting) == self._waiting.maxlen
            self._waiting.append(frame)
            self._changed.notify()

    def close(self) -> None:
        with self._changed:
            self._is_closed = True
            self._changed.notify()
        self._thread.join(self._close_s)

    def _run(self) -> None:
        retry_s = self._retry_s[0]
        while (frame := self._next()) is not None:
            error = self._send(frame)
            if error is None:
                retry_s = self._retry_s[0]
                continue
            if self._pause(retry_s):
                break
            retry_s = min(2 * retry_s, self._retry_s[1])
        self._close_sink()

    def _next(self) -> LiveFrame | None:
        """The next frame, when there is one; None: the output is closed, and none waits."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._is_closed)
            return self._waiting.popleft() if self._waiting else None

    def _send(self, frame: LiveFrame) -> Exception | None:
        self._sending_since_s = time.monotonic()
        try:
            self._sink = self._sink or self._open_sink()
            self._sink.send(frame)
        # A consumer may fail in any way; none may end the thread.
        except Exception as error:
            self._close_sink()
            with self._changed:
                self._n_skipped += 1
            self._last_error = f"{type(error).__name__}: {error}"
            self._say(not self._is_failing, f"{self.name} does not work ({self._last_error}); it is tried again")
            self._is_failing = True
            return error
        finally:
            self._sending_since_s = None
        self._n_published += 1
        self._say(self._is_failing, f"{self.name} works again")
        self._is_failing = False
        return None

    def _say(self, is_news: bool, line: str) -> None:
        if is_news and self._tell is not None:
            self._tell(line)

    def _pause(self, duration_s: float) -> bool:
        """Whether the output is closed meanwhile."""
        with self._changed:
            return self._changed.wait_for(lambda: self._is_closed, duration_s)

    def _close_sink(self) -> None:
        sink, self._sink = self._sink, None
        if sink is not None:
            with contextlib.suppress(Exception):
                sink.close()
