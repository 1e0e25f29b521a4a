"""What takes the frames of a live system, and how it is kept from holding the others up."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from fgpose.live.frame import LiveFrame
from fgpose.live.processes.parts import Parts
from fgpose.live.processes.worker import Worker

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
    is_file: bool = False

    @property
    def is_incomplete(self) -> bool:
        """It is a file that lacks something, if only its end."""
        return self.is_file and (self.n_lost > 0 or not self.is_working)

    @property
    def fault(self) -> str:
        """What is wrong with it; empty: nothing."""
        missing = f"{self.n_lost} frames or records are missing in it" if self.n_lost else ""
        why = "" if self.is_working else self.last_error or "it does not work"
        return "; ".join(part for part in (why, missing) if part)


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


@runtime_checkable
class FileSink(Sink, Protocol):
    """Writes frames to a file, one after the other if it is closed and opened again."""

    @property
    def n_held(self) -> int:
        """Frames that were taken and are not written: lost if writing fails now, or if closing failed."""
        ...

    def note_lost(self, n_frames: int) -> None:
        """Write that so many frames of all that came until now are missing, in this file or between files."""
        ...


class BackgroundOutput:
    """Any sink as an output: it works in a thread of its own, which takes the newest frame whenever it is ready or, for
    files, the oldest of a few that wait.

    A sink that raises is closed and opened again, after a pause that doubles each time. What a file lacks is counted
    and written into it; a file of which only the newest frame waits is a view, in which what is skipped while it works
    is not missing.

    Args:
        name: for people.
        open_sink: opens the sink. It is opened first before this returns, so that what is wrong from the start (a port
            that is taken) is raised here.
        n_waiting: frames that may wait for the sink; beyond that the oldest are skipped.
        tell: called with one line when the output stops working, and when it works again.
        first_retry_s: the first pause.
        longest_retry_s: the longest.
        close_s: closing waits so long for a frame on its way and for the sink; then they are left behind.
        parts: told when the sink, or the thread, has ended.

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
        longest_retry_s: float = 5.0,
        close_s: float = _CLOSE_S,
        parts: Parts | None = None,
    ) -> None:
        self.name = name
        self._open_sink, self._tell, self._parts = open_sink, tell, parts or Parts()
        self._retry_s, self._close_s = (first_retry_s, longest_retry_s), close_s
        self._sink: Sink | None = open_sink()
        self._changed = threading.Condition()
        self._waiting: deque[LiveFrame] = deque(maxlen=n_waiting)
        self._is_closed = False
        self._is_file = isinstance(self._sink, FileSink)
        self._n_published = self._n_skipped = self._n_lost = 0
        self._n_noted = 0
        """What the file says of the lost ones."""
        self._is_failing, self._last_error = False, ""
        self._sending_since_s: float | None = None
        self._worker = Worker(name, self._run, self._parts)
        self._worker.start()

    @property
    def state(self) -> OutputState:
        since_s = self._sending_since_s
        is_working, error = not self._is_failing, self._last_error
        if since_s is not None and time.monotonic() - since_s > _HUNG_S:
            is_working, error = False, f"it has not taken a frame for {time.monotonic() - since_s:.0f} s"
        counts = self._n_published, self._n_skipped
        return OutputState(self.name, is_working, *counts, error, self._n_lost, self._is_file)

    def publish(self, frame: LiveFrame) -> None:
        with self._changed:
            if self._is_closed:
                return
            is_full = len(self._waiting) == self._waiting.maxlen
            self._n_skipped += is_full
            self._n_lost += is_full and self._is_file and (self._waiting.maxlen != 1 or self._is_failing)
            self._waiting.append(frame)
            self._changed.notify()

    def close(self) -> None:
        with self._changed:
            self._is_closed = True
            self._changed.notify()
        self._worker.close(self._close_s)
        if self._worker.is_alive and self._is_file:
            self._fail(TimeoutError(f"it has not taken the rest within {self._close_s:.0f} s"), len(self._waiting) + 1)

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
        with self._changed:
            self._count_failed(len(self._waiting))
            self._waiting.clear()
        self._close_sink()

    def _next(self) -> LiveFrame | None:
        """The next frame, when there is one; None: the output is closed, and none waits."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._is_closed)
            return self._waiting.popleft() if self._waiting else None

    def _send(self, frame: LiveFrame) -> Exception | None:
        self._sending_since_s = time.monotonic()
        try:
            self._note_lost()
            self._opened().send(frame)
        # A consumer may fail in any way; none may end the thread.
        except Exception as error:
            self._fail(error, 1)
            self._close_sink()
            self._parts.count(self.name, f"{type(error).__name__}: {error}")
            return error
        finally:
            self._sending_since_s = None
        self._n_published += 1
        self._say(self._is_failing, f"{self.name} works again")
        self._is_failing = False
        return None

    def _opened(self) -> Sink:
        if self._sink is None:
            self._sink, self._n_noted = self._open_sink(), 0
        return self._sink

    def _note_lost(self) -> None:
        n_lost = self._n_lost
        if n_lost > 0 and isinstance(sink := self._opened(), FileSink) and n_lost > self._n_noted:
            sink.note_lost(n_lost)
            self._n_noted = n_lost

    def _fail(self, error: Exception, n_frames: int) -> None:
        with self._changed:
            self._count_failed(n_frames)
        self._last_error = f"{type(error).__name__}: {error}"
        self._say(not self._is_failing, f"{self.name} does not work ({self._last_error}); it is tried again")
        self._is_failing = True

    def _count_failed(self, n_frames: int) -> None:
        self._n_skipped += n_frames
        self._n_lost += n_frames * self._is_file

    def _say(self, is_news: bool, line: str) -> None:
        if is_news and self._tell is not None:
            self._tell(line)

    def _pause(self, duration_s: float) -> bool:
        """Whether the output is closed meanwhile."""
        with self._changed:
            return self._changed.wait_for(lambda: self._is_closed, duration_s)

    def _close_sink(self) -> None:
        sink = self._sink
        if sink is None:
            return
        try:
            if not self._is_failing:
                self._note_lost()
            sink.close()
        except Exception as error:
            if self._is_file and not self._is_failing:
                self._fail(error, 0)
        self._sink = None
        if isinstance(sink, FileSink) and (n_held := sink.n_held):
            with self._changed:
                self._n_published -= n_held
                self._count_failed(n_held)
