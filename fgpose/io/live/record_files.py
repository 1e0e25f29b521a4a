"""Files that only grow, record by record: whatever kills the writer, all records but perhaps the last can be read.

After eight bytes that say what the file is, each record has a head of three little-endian 32-bit numbers: the length of
its body in bytes, the CRC-32 of the body, and that of the two numbers. So a file that was cut off can be told from one
that is damaged.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from fgpose.plain_files import open_plain

MAGIC = b"fgpLIVE1"
_NUMBERS = struct.Struct("<II")
_HEAD = struct.Struct("<III")
# Many times what all images of a moment take.
_MAX_BODY_BYTES = 256 << 20


def as_record(body: bytes) -> bytes:
    """A body with its head. Raises ValueError if it is longer than a record may be."""
    if len(body) > _MAX_BODY_BYTES:
        raise ValueError(f"a record has {len(body)} bytes, at most {_MAX_BODY_BYTES} are possible")
    length, body_crc = len(body), zlib.crc32(body)
    return _HEAD.pack(length, body_crc, zlib.crc32(_NUMBERS.pack(length, body_crc))) + body


class RecordFile:
    """The bodies of the records of a file, in order.

    After iteration lost_bytes says how many at the end are no whole record: the file was cut off there.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.lost_bytes = 0

    def __iter__(self) -> Iterator[bytes]:
        """Read from the beginning.

        Raises:
            ValueError: the file is of another kind, or damaged other than by being cut off; the caller names it.
            OSError: it cannot be read.
        """
        self.lost_bytes = 0
        n_bytes = self.path.stat().st_size
        with open_plain(self.path) as file:
            if file.read(len(MAGIC)) != MAGIC:
                raise ValueError("not a live recording of fgpose")
            while (start := file.tell()) < n_bytes:
                body = self._body(file, n_bytes)
                if body is None:
                    self.lost_bytes = n_bytes - start
                    return
                yield body

    def _body(self, file: BinaryIO, n_bytes: int) -> bytes | None:
        """Of the next record; None where the file ends in the middle of it."""
        start = file.tell()
        head = file.read(_HEAD.size)
        if len(head) < _HEAD.size:
            return None
        length, body_crc, numbers_crc = _HEAD.unpack(head)
        if zlib.crc32(head[: _NUMBERS.size]) != numbers_crc:
            # After a power cut a file system may leave zeros where the last bytes should be.
            if not any(head) and _only_zeros(file):
                return None
            raise ValueError(f"damaged at byte {start}")
        if length > _MAX_BODY_BYTES:
            raise ValueError(f"damaged at byte {start}: a record of {length} bytes")
        if file.tell() + length > n_bytes:
            return None
        body = file.read(length)
        if zlib.crc32(body) != body_crc:
            raise ValueError(f"damaged at byte {start + _HEAD.size}, or in the {length} bytes after it")
        return body


def _only_zeros(file: BinaryIO) -> bool:
    while part := file.read(1 << 20):
        if any(part):
            return False
    return True
