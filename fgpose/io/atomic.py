"""Result files appear whole or not at all."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


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


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path in the folder of path, with its extension, that replaces path once the block has ended well.

    After an exception neither the temporary file nor a new one is left, and an old file stays as it was.

    Raises:
        OSError: the folder cannot be written into.
    """
    check_writable(path.parent)
    temporary = _temporary(path)
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def _temporary(path: Path) -> Path:
    return path.with_name(f".{path.stem}.{secrets.token_hex(4)}{path.suffix}")
