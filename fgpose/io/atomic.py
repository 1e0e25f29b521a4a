"""Result files appear whole or not at all."""

from __future__ import annotations

import fcntl
import os
import re
import secrets
import stat
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

_TEMPORARY = re.compile(r"\.fgpose-[0-9a-f]{8}(\..*)?")

Check = Callable[[Path], None]
"""Reopens a file that has just been written. Raises ValueError or OSError if something of it is missing."""


def check_writable(folder: str | Path) -> None:
    """Make sure, before any work is done, that results can be written into a folder; it is made if it is absent.

    Raises:
        OSError: it cannot be made or written into; the message names it.
    """
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _remove_leftovers(folder)
        with _temporary_file(folder / "probe"):
            pass
    except OSError as error:
        raise OSError(f"cannot write results into {folder}: {error.strerror or error}") from None


@contextmanager
def no_empty_folders(path: Path) -> Iterator[None]:
    """An error meanwhile leaves no folder behind that was made for a result at this path and holds nothing."""
    absent = [folder for folder in (path, *path.parents) if not folder.exists()]
    try:
        yield
    except BaseException:
        for folder in absent:
            with suppress(OSError):
                folder.rmdir()
        raise


def check_replaceable(path: str | Path) -> None:
    """Make sure, before any work is done, that a file can be written; its folder is made if it is absent.

    Raises:
        OSError: its folder cannot be written into, or what has its name is no plain file; the message names it.
    """
    check_writable(_plain_file(Path(path)).parent)


class NotWrittenError(OSError):
    """A file could not be written; the message names it."""


def not_written(path: object, error: object) -> NotWrittenError:
    """The error of a file, with the reason of another."""
    return NotWrittenError(f"cannot write {path}: {getattr(error, 'strerror', None) or error}")


@contextmanager
def replacing(path: Path, check: Check) -> Iterator[Path]:
    """A temporary file with the extension of path that replaces path once the block has ended well.

    After an exception neither the temporary file nor a new one is left, and an old file stays as it was. What a link
    leads to is replaced, not the link. The new file has the permissions of the old one.

    Args:
        path: the file.
        check: verifies the file on the disk, since not every library reports that the disk is full.

    Raises:
        NotWrittenError: the file cannot be written, or is not whole.
        OSError: there is a folder, a device or a pipe of this name, or another error of the block.
    """
    target = _plain_file(path)
    check_writable(target.parent)
    with _temporary_file(target) as temporary:
        try:
            yield temporary
            _flush(temporary)
            _checked(path, temporary, check)
            _keep_permissions(target, temporary)
            os.replace(temporary, target)
        except OSError as error:
            if isinstance(error, NotWrittenError) or error.filename not in (None, str(temporary)):
                raise
            raise not_written(path, error) from None


def _plain_file(path: Path) -> Path:
    """Where a link leads, else the path. Raises OSError if that is there and no plain file."""
    target = Path(os.path.realpath(path)) if path.is_symlink() else path
    if target.is_dir():
        raise OSError(f"cannot write {path}: it is a folder")
    if target.is_symlink() or (target.exists() and not target.is_file()):
        raise OSError(f"cannot write {path}: it is no plain file")
    return target


@contextmanager
def _temporary_file(path: Path) -> Iterator[Path]:
    """A new file in the folder of path. It is locked as long as its process lives: one that is not was left by a
    process that was killed, and is removed by whoever writes there next (check_writable)."""
    while True:
        temporary = path.with_name(f".fgpose-{secrets.token_hex(4)}{path.suffix}")
        # What only some may read is not shown to others meanwhile.
        file = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600 if path.exists() else 0o666)
        _lock(file, fcntl.LOCK_EX)
        if os.fstat(file).st_nlink:
            break
        os.close(file)  # another process has taken it for a leftover before it was locked
    try:
        yield temporary
    finally:
        temporary.unlink(missing_ok=True)
        os.close(file)


def _remove_leftovers(folder: Path) -> None:
    for name in filter(_TEMPORARY.fullmatch, os.listdir(folder)):
        with suppress(OSError):
            file = os.open(folder / name, os.O_WRONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
            try:
                if _lock(file, fcntl.LOCK_EX | fcntl.LOCK_NB):
                    os.unlink(folder / name)
            finally:
                os.close(file)


def _lock(file: int, how: int) -> bool:
    """Whether it could be locked: others may hold it, and not every file system has locks."""
    try:
        fcntl.flock(file, how)
    except OSError:
        return False
    return True


def _keep_permissions(old: Path, new: Path) -> None:
    if old.exists():
        known = old.stat()
        with suppress(PermissionError):
            os.chown(new, known.st_uid, known.st_gid)
        new.chmod(stat.S_IMODE(known.st_mode))


def _flush(path: Path) -> None:
    """Flush to the disk, so that a delayed write fails here."""
    with path.open("r+b") as file:
        os.fsync(file.fileno())


def _checked(path: Path, temporary: Path, check: Check) -> None:
    try:
        check(temporary)
    except (ValueError, OSError) as error:
        reason = str(error).replace(str(temporary), path.name)
        raise not_written(path, f"what stands on the disk is not whole ({reason}); is it full?") from None


def write_bytes(path: Path, content: bytes) -> None:
    """Replace a file by this content, whole or not at all.

    Raises:
        OSError: it cannot be written; the message names it.
    """
    with writing(path) as file:
        file.write(content)


def write_text(path: Path, text: str) -> None:
    """Replace a file by this text in UTF-8, line ends as they are. Raises OSError as write_bytes does."""
    write_bytes(path, text.encode("utf-8"))


def write_lines(path: Path, lines: Iterable[str]) -> None:
    """Replace a file by these lines in UTF-8, which are written as they come. Raises OSError as write_bytes does."""
    with writing(path) as file:
        for line in lines:
            file.write(f"{line}\n".encode())


@contextmanager
def writing(path: Path) -> Iterator[BinaryIO]:
    """A file to write into, which replaces that at the path once the block has ended well; as replacing does."""
    n_bytes = 0

    def check(temporary: Path) -> None:
        found = temporary.stat().st_size
        if found != n_bytes:
            raise ValueError(f"{found} of {n_bytes} bytes")

    with replacing(path, check) as temporary, temporary.open("wb") as file:
        yield file
        n_bytes = file.tell()
