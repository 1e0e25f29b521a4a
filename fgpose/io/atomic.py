"""Result files appear whole or not at all."""

from __future__ import annotations

import os
import secrets
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

Check = Callable[[Path], None]
"""Reopens a file that has just been written. Raises ValueError or OSError if something of it is missing."""


def check_writable(folder: str | Path) -> None:
    """Make sure, before any work is done, that results can be written into a folder; it is made if it is absent.

    Raises:
        OSError: it cannot be made or written into; the message names it.
    """
    folder = Path(folder)
    probe = _temporary(folder / "probe")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise OSError(f"cannot write results into {folder}: {error.strerror or error}") from None


class NotWrittenError(OSError):
    """A file could not be written."""

    def __init__(self, path: object, reason: object) -> None:
        super().__init__(f"cannot write {path}: {reason}")


@contextmanager
def replacing(path: Path, check: Check) -> Iterator[Path]:
    """A temporary path in the folder of path, with its extension, that replaces path once the block has ended well.

    After an exception neither the temporary file nor a new one is left, and an old file stays as it was.

    Args:
        path: the file.
        check: verifies the file on the disk, since not every library reports that the disk is full.

    Raises:
        NotWrittenError: the file cannot be written, or is not whole.
        OSError: another error of the block.
    """
    check_writable(path.parent)
    temporary = _temporary(path)
    try:
        yield temporary
        _flush(temporary)
        _checked(path, temporary, check)
        os.replace(temporary, path)
    except OSError as error:
        if isinstance(error, NotWrittenError) or error.filename not in (None, str(temporary)):
            raise
        raise NotWrittenError(path, error.strerror or error) from None
    finally:
        temporary.unlink(missing_ok=True)


def _temporary(path: Path) -> Path:
    return path.with_name(f".{path.stem}.{secrets.token_hex(4)}{path.suffix}")


def _flush(path: Path) -> None:
    """Flush to the disk, so that a delayed write fails here."""
    with path.open("r+b") as file:
        os.fsync(file.fileno())


def _checked(path: Path, temporary: Path, check: Check) -> None:
    try:
        check(temporary)
    except (ValueError, OSError) as error:
        reason = str(error).replace(str(temporary), path.name)
        raise NotWrittenError(path, f"what stands on the disk is not whole ({reason}); is it full?") from None


def write_bytes(path: Path, content: bytes) -> None:
    """Replace a file by this content, whole or not at all.

    Raises:
        OSError: it cannot be written; the message names it.
    """
    with replacing(path, _has_size(len(content))) as temporary:
        temporary.write_bytes(content)


def write_text(path: Path, text: str) -> None:
    """Replace a file by this text in UTF-8, line ends as they are. Raises OSError as write_bytes does."""
    write_bytes(path, text.encode("utf-8"))


def _has_size(n_bytes: int) -> Check:
    def check(path: Path) -> None:
        found = path.stat().st_size
        if found != n_bytes:
            raise ValueError(f"{found} of {n_bytes} bytes")

    return check
