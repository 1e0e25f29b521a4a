"""The bytes of a file, with errors that name it also when a disk fails in the middle of it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fgpose.plain_files import MAX_FILE_BYTES, open_plain

_PART_BYTES = 1 << 20  # a file without an end, as some of /proc are, is noticed this much too late at most
_UTF_16 = (b"\xff\xfe", b"\xfe\xff")


def read_content(path: Path, max_bytes: int = MAX_FILE_BYTES) -> bytes:
    """Everything in a file, text as UTF-8.

    Raises:
        ValueError: it has more bytes than this, perhaps no end; the caller names it.
        OSError: it cannot be read; the message names it.
    """
    content = bytearray()
    with _naming(path), open_plain(path) as file:
        while part := file.read(_PART_BYTES):
            content += part
            if len(content) > max_bytes:
                raise ValueError(f"it has more than {max_bytes} bytes")
    if content.startswith(_UTF_16):  # what PowerShell's > writes
        return content.decode("utf-16").encode()
    return bytes(content)


def first_bytes(path: Path, n_bytes: int) -> bytes:
    """The beginning of a file, all of it if it is shorter. Raises OSError, which names it, if it cannot be read."""
    with _naming(path), open_plain(path) as file:
        return file.read(n_bytes)


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        # Only opening says which file it was.
        error.filename = error.filename or str(path)
        raise
