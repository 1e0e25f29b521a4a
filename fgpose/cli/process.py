"""What a command is given by the system: its arguments, signals, and streams (closed, full, or without a reader)."""

from __future__ import annotations

import os
import shlex
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from types import FrameType
from typing import Any

_ARGUMENTS: ContextVar[tuple[str, ...]] = ContextVar("arguments", default=())
TERMINATED = 128 + signal.SIGTERM
"""Exit code after SIGTERM."""


def set_arguments(arguments: Sequence[str]) -> None:
    """Remember what main was called with, for the results that are made."""
    _ARGUMENTS.set(tuple(arguments))


def command_line() -> str:
    """As it can be typed into a shell."""
    return shlex.join(["fgpose", *_ARGUMENTS.get()])


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
    _silence(sys.stdout)


def _silence(stream: Any) -> None:
    """What is written to it from now on is lost."""
    with suppress(OSError, ValueError), open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), stream.fileno())


@contextmanager
def forgiving_streams() -> Iterator[None]:
    """Meanwhile what cannot be written to stderr is lost, and nothing else is taken for a stream that is closed."""
    open_streams()
    before = sys.stderr
    with open(os.devnull, "w") as nowhere:
        sys.stderr = _Forgiving(before or nowhere)
        try:
            yield
        finally:
            sys.stderr = before
            _forget_unwritten(before)


def _forget_unwritten(stream: Any) -> None:
    """What a stream still holds would be written when Python ends, which then ends with an error."""
    if stream is None:
        return
    try:
        stream.flush()
    except (OSError, ValueError):
        _silence(stream)


class _Forgiving:
    """A text stream that never raises for what is written."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        with suppress(OSError, ValueError):
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        with suppress(OSError, ValueError):
            self._stream.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)
