"""Files that somebody else may have made: plain ones only, how much of what they hold is too much, and what is said of
them.

A pipe keeps its reader waiting for ever, a device has no end, and some thousand bytes can stand for all of the memory.
"""

from __future__ import annotations

import errno
import io
import os
import stat
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

MAX_FILE_GB = "FGPOSE_MAX_FILE_GB"
"""The environment variable that raises max_file_bytes and max_text_bytes."""
MAX_SETTINGS_BYTES = 1 << 20
"""Of a file of settings: a configuration, a study, a skeleton, a live rig. TOML takes a second to be read for each
megabyte."""
MAX_CALIBRATION_BYTES = 10 << 20
"""Of the calibration of all cameras. That of one takes some hundred bytes, with the corners of its boards some thousand
times as much."""
MAX_CAMERAS = 1000
"""Of a rig."""
MAX_IMAGE_PX = 1 << 27
"""Of an image: 134 million pixels, 400 MB."""
MAX_UNSUSPICIOUS_BYTES = 256 << 20
"""A file may stand for as much as this, however small it is."""
MAX_EXPANSION = 200
"""Beyond that, how many times its size. What nobody sees is compressed a hundred times, what is seen some times."""
MAX_JSON_EXPANSION = 16
"""The same of JSON. Keypoints as whole pixels take 13 times as much in memory, lists of nothing 30 times."""
MAX_LINE = 10_000_000
"""Characters of a line of a text. A frame of the largest skeleton takes a thirtieth."""
MAX_EMPTY_LINES = 10_000
"""Of a text, one after the other: a hundred megabytes of them take a quarter of a minute."""
MAX_MESSAGE = 1500
"""Characters of what is said of a file: the names of all joints of a body fit, a damaged file does not."""

# OpenCV reads it when it is loaded. Its own limit lets an image take 3 GB.
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(MAX_IMAGE_PX))


def max_file_bytes() -> int:
    """Of keypoints and results, in a file and in memory: 4 GB, or what the environment says. Eight hours of eight
    cameras at 60 Hz with per-view 3D and its covariance take less.

    Raises:
        ValueError: the environment says something that is no number of gigabytes.
    """
    given = os.environ.get(MAX_FILE_GB, "4")
    try:
        return int(float(given) * (1 << 30))
    except (ValueError, OverflowError):
        raise ValueError(f"{MAX_FILE_GB} is {given!r}, no number of gigabytes") from None


def max_text_bytes() -> int:
    """Of keypoints and results as text, a quarter of that: in memory text takes some times its size, and an hour of a
    body at 60 Hz takes 300 MB. Raises as max_file_bytes."""
    return max_file_bytes() // 4


@contextmanager
def naming(name: object, instead_of: str = "", damage: Sequence[type[Exception]] = ()) -> Iterator[None]:
    """Read a file: what goes wrong with it is said with its name, and in not more than MAX_MESSAGE characters.

    Args:
        name: of the file, or what it is called in messages; no message names it twice.
        instead_of: what it should have been, before the reason: "not a skeleton".
        damage: what its damaged contents raise apart from ValueError; OSError: those that the system has not raised.

    Raises:
        ValueError: there was one, or one of damage, or the file is nested too deeply.
        OSError: there was one of the system.
        numpy.linalg.LinAlgError: there was one. It is a ValueError, but of ours, not of the file.
    """
    try:
        yield
    except np.linalg.LinAlgError:
        raise
    except RecursionError:
        raise ValueError(f"{name}: it is nested too deeply") from None
    except (OSError, ValueError, *damage) as error:  # pyrefly: ignore[not-a-type]
        # Libraries have OSErrors of their own for damage; of those of the system only opening says which file it was.
        if isinstance(error, OSError) and (error.errno is not None or OSError not in damage):
            if error.errno is not None:
                error.filename = shortened(str(error.filename or name))
            raise
        reason = f"{error.args[0]} is missing" if isinstance(error, KeyError) else str(error)
        reason = shortened(f"{instead_of}: {reason}" if instead_of else reason)
        raise ValueError(reason if str(name) in reason else f"{name}: {reason}") from None


def shortened(text: str, longest: int = MAX_MESSAGE) -> str:
    """A text with only its beginning and its end if it is longer: it may quote all of a file."""
    if len(text) <= longest:
        return text
    end = longest // 5
    return f"{text[: longest - end]} [{len(text) - longest} characters] {text[-end:]}"


def check_plain(path: Path) -> None:
    """Make sure that opening and reading a file comes to an end.

    Raises:
        OSError: it does not exist, is a folder, a pipe, a socket or a device; the message names it.
    """
    mode = os.stat(path).st_mode
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, "no plain file but a pipe or a device", str(path))


def open_plain(path: Path) -> io.BufferedReader:
    """A plain file, opened to be read. Raises OSError as check_plain does, or if it cannot be read."""
    check_plain(path)
    return path.open("rb")


def read_settings(path: Path) -> str:
    """The text of a file of settings.

    Raises:
        ValueError: it is larger than MAX_SETTINGS_BYTES, or no UTF-8; the caller names it.
        OSError: as open_plain.
    """
    with open_plain(path) as file:
        content = file.read(MAX_SETTINGS_BYTES + 1)
    if len(content) > MAX_SETTINGS_BYTES:
        raise ValueError(f"it has more than {MAX_SETTINGS_BYTES} bytes, too many for a file of settings")
    return content.decode("utf-8")


def check_expansion(n_bytes: int, of_bytes: int, most: int = MAX_EXPANSION) -> None:
    """Compare the memory that the contents of a file would take with its size, before they are read.

    Args:
        n_bytes: what they would take.
        of_bytes: its size.
        most: how many times its size is not too much.

    Raises:
        ValueError: they would take too much; the caller names the file.
    """
    if n_bytes > max(MAX_UNSUSPICIOUS_BYTES, most * of_bytes):
        raise ValueError(f"its {of_bytes} bytes stand for {n_bytes}, more than fgpose reads")
    if n_bytes > max_file_bytes():
        raise ValueError(f"it takes {n_bytes} bytes, more than fgpose reads unless {MAX_FILE_GB} is set")
