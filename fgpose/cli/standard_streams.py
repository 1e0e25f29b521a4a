"""Standard streams that are closed, full or broken: what runs for days goes on without them."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from fgpose.cli.streams_and_signals import open_streams


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
        with suppress(OSError, ValueError), open(os.devnull, "w") as nowhere:
            os.dup2(nowhere.fileno(), stream.fileno())


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
