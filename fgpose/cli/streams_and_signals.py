"""What a command is given by the system: signals, and streams that may be closed, full or of a reader who has gone."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType

TERMINATED = 128 + signal.SIGTERM
"""Exit code after SIGTERM."""


class Interruption:
    """Whether Ctrl-C came. The interrupt may end in the middle of anything, and become any error there."""

    has_come = False

    def interrupt(self, *_: int | FrameType | None) -> None:
        self.has_come = True
        raise KeyboardInterrupt


@contextmanager
def signals_as_exceptions() -> Iterator[Interruption]:
    """Ctrl-C raises KeyboardInterrupt and SIGTERM SystemExit, so that temporary files are removed and processes ended.
    Signals that are ignored, or that somebody else waits for, are left alone."""
    interruption = Interruption()
    handlers = {
        signal.SIGINT: (interruption.interrupt, (signal.SIG_DFL, signal.default_int_handler)),
        signal.SIGTERM: (_terminate, (signal.SIG_DFL,)),
    }
    before = {}
    if threading.current_thread() is threading.main_thread():
        for number, (handler, replaced) in handlers.items():
            if signal.getsignal(number) in replaced:
                before[number] = signal.signal(number, handler)
    try:
        yield interruption
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _terminate(*_: int | FrameType | None) -> None:
    raise SystemExit(TERMINATED)


def open_streams() -> None:
    """Nothing in place of streams that are closed (``>&-``): else the next file that is opened would get what is
    printed."""
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        try:
            os.fstat(number)
        except OSError:
            # The lowest number that is free.
            os.open(os.devnull, os.O_RDWR)
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(number, mode, closefd=False))


def say(line: str) -> None:
    """On stderr, where somebody may read it or not."""
    with suppress(OSError, ValueError):
        sys.stderr.write(line)
        sys.stderr.flush()


def silence_stdout() -> None:
    """It cannot be written. Python must not complain again when it ends."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
