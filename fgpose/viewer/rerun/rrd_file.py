"""The file of a recording in Rerun, written by ourselves."""

from __future__ import annotations

import io
import os
import threading
from collections import deque
from pathlib import Path
from typing import BinaryIO

import rerun as rr

_PART_BYTES = 1 << 16


class RrdFile:
    """Takes what Rerun writes out of a pipe, and writes it to the disk.

    Rerun's own writer ends when the disk is full, and everything that waits for it then waits for ever. Here it never
    waits for the disk: one thread takes what comes, another one writes it, and says what is wrong.

    Args:
        path: of the file.
        with_footer: it is made for random access; the footer grows in memory.

    Raises:
        OSError: it cannot be made.
    """

    def __init__(self, path: Path, *, with_footer: bool) -> None:
        self.path = path
        file = path.open("wb", buffering=0)
        read_end, self._write_end = os.pipe()
        self.sink = rr.FileSink(f"/dev/fd/{self._write_end}", write_footer=with_footer)
        """For the stream; then call is_opened."""
        self._changed = threading.Condition()
        self._waiting: deque[bytes] = deque()
        self._is_ended = False
        self._error: OSError | None = None
        self._threads = [
            threading.Thread(target=work, args=(end,), name=f"fgpose rrd {name}", daemon=True)
            for name, work, end in (("taker", self._take, io.FileIO(read_end)), ("writer", self._write, file))
        ]
        for thread in self._threads:
            thread.start()

    def is_opened(self) -> None:
        """Rerun has opened the sink, or never will: the file ends when it closes it."""
        os.close(self._write_end)

    def flush(self, timeout_s: float) -> None:
        """Wait until all but the last moment is written. Raises OSError if that is not possible."""
        with self._changed:
            if not self._changed.wait_for(lambda: not self._waiting, timeout_s):
                raise TimeoutError(f"the disk has not taken it within {timeout_s:.0f} s")
            if self._error is not None:
                raise self._error

    def close(self, timeout_s: float) -> None:
        """Wait until all is written, once Rerun has closed the sink. Raises OSError if that is not possible."""
        for thread in self._threads:
            thread.join(timeout_s)
        self.flush(0.0)

    def _take(self, pipe: io.FileIO) -> None:
        with pipe:
            while part := pipe.read(_PART_BYTES):
                with self._changed:
                    if self._error is None:
                        self._waiting.append(part)
                        self._changed.notify_all()
        with self._changed:
            self._is_ended = True
            self._changed.notify_all()

    def _write(self, file: BinaryIO) -> None:
        try:
            with file:
                while part := self._oldest():
                    left = memoryview(part)
                    while left:
                        left = left[file.write(left) :]
                    with self._changed:
                        self._waiting.popleft()
                        self._changed.notify_all()
        except OSError as error:
            with self._changed:
                self._error = error
                self._waiting.clear()
                self._changed.notify_all()

    def _oldest(self) -> bytes:
        """The next that is to be written, when there is one; empty: nothing more will come."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._is_ended)
            return self._waiting[0] if self._waiting else b""
