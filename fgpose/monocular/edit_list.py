"""What an MP4 or QuickTime file shows of the images that it holds: programs cut videos by a list of what is shown."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import BinaryIO

from fgpose.plain_files import open_plain

# More boxes beside each other, and a longer list, are not read.
_MAX_BOXES = 10_000
_MAX_LIST_BYTES = 1 << 16
_EMPTY = -1

_Span = tuple[int, int]
"""Where the content of a box begins and ends in the file."""


def shown_share(path: Path) -> float:
    """The share of its video that a file shows, of the time that it holds; 1 of all other files.

    Raises OSError if it cannot be read.
    """
    with open_plain(path) as file:
        everything = 0, path.stat().st_size
        for movie in _boxes(file, everything, b"moov"):
            for track in _boxes(file, movie, b"trak"):
                if _within(file, track, b"mdia", b"hdlr")[8:12] == b"vide":
                    return _share(
                        _within(file, movie, b"mvhd"),
                        _within(file, track, b"mdia", b"mdhd"),
                        _within(file, track, b"edts", b"elst"),
                    )
    return 1.0


def _share(movie_header: bytes, media_header: bytes, edits: bytes) -> float:
    try:
        (movie_ticks_hz, _), (media_ticks_hz, n_media) = _clock(movie_header), _clock(media_header)
        form = ">QqI" if edits[0] else ">IiI"
        (n_parts,) = struct.unpack_from(">I", edits, 4)
        parts = struct.iter_unpack(form, edits[8 : 8 + n_parts * struct.calcsize(form)])
        shown_s = sum(ticks for ticks, first, _ in parts if first != _EMPTY) / movie_ticks_hz
        return min(shown_s / (n_media / media_ticks_hz), 1.0) or 1.0
    except (struct.error, IndexError, ZeroDivisionError):
        return 1.0


def _clock(header: bytes) -> tuple[int, int]:
    """Ticks in a second, and how many it lasts."""
    return struct.unpack_from(">IQ", header, 20) if header[0] else struct.unpack_from(">II", header, 12)


def _within(file: BinaryIO, span: _Span, *kinds: bytes) -> bytes:
    """The content of the first box in the first boxes of these kinds; nothing if there is none."""
    for kind in kinds:
        span = next(_boxes(file, span, kind), (0, 0))
    file.seek(span[0])
    return file.read(min(span[1] - span[0], _MAX_LIST_BYTES))


def _boxes(file: BinaryIO, span: _Span, kind: bytes) -> Iterator[_Span]:
    return (inside for own, inside in islice(_all_boxes(file, span), _MAX_BOXES) if own == kind)


def _all_boxes(file: BinaryIO, span: _Span) -> Iterator[tuple[bytes, _Span]]:
    start, end = span
    while start + 8 <= end:
        file.seek(start)
        size, kind, long_size = struct.unpack(">I4sQ", file.read(16).ljust(16, b"\0"))
        head = 16 if size == 1 else 8
        size = {0: end - start, 1: long_size}.get(size, size)
        if size < head:
            return
        yield kind, (start + head, min(start + size, end))
        start += size
