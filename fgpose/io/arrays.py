"""NumPy archives (npz): checked when read, written whole or not at all."""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np

from fgpose.io.atomic import write_bytes
from fgpose.io.content import damage, read_content
from fgpose.plain_files import check_expansion, max_file_bytes, open_plain

Kind = Literal["numbers", "whole numbers", "truth values", "texts"]

_KINDS: dict[Kind, str] = {"numbers": "fiu", "whole numbers": "iu", "truth values": "b", "texts": "U"}
_PLAIN = "biufcUS"
# Deflate compresses by at most 1032 to 1; a member that declares more is damaged.
_MAX_COMPRESSION = 1040
# Bounds the rows of arrays that are empty in the file: four hours at 60 Hz.
_MAX_EMPTY_ROWS = 1_000_000


def read_arrays(path: Path, only: Collection[str] | None = None) -> dict[str, np.ndarray]:
    """The arrays of an npz, all or only those named, without pickles. Members that are no arrays are left out.

    The size that an array declares is compared with that of its member before any memory is taken.

    Raises:
        ValueError: the file is damaged or something else; the caller names it.
        OSError: it cannot be opened.
    """
    with open_plain(path) as stream:
        return unpack_arrays(stream, only)


def unpack_arrays(stream: io.BufferedIOBase, only: Collection[str] | None = None) -> dict[str, np.ndarray]:
    """As read_arrays, of an open file."""
    with damage("a damaged npz"):
        return _read_archive(stream, only)


def read_array(path: Path) -> np.ndarray:
    """The array of an npy, without pickles, its size compared as by read_arrays. Raises as that does."""
    content = io.BytesIO(read_content(path, max_file_bytes()))
    with damage("a damaged npy"):
        return _read_array(path.stem, content, len(content.getvalue()))


def array_names(path: Path) -> set[str]:
    """Names of the arrays of an npz, whose numbers are not read. Raises as read_arrays does."""
    with opened_archive(path) as archive:
        return {_array_name(member) for member in archive.infolist() if _is_array(member)}


@contextmanager
def opened_archive(path: Path) -> Iterator[zipfile.ZipFile]:
    """An npz with all of its members. What goes wrong with it in the block is raised as read_arrays does."""
    with open_plain(path) as stream, damage("a damaged npz"), zipfile.ZipFile(stream) as archive:
        yield archive


def _read_archive(stream: io.BufferedIOBase, only: Collection[str] | None) -> dict[str, np.ndarray]:
    arrays: dict[str, np.ndarray] = {}
    n_bytes, of_bytes = 0, stream.seek(0, io.SEEK_END)
    with zipfile.ZipFile(stream) as archive:
        for member in filter(_is_array, archive.infolist()):
            name = _array_name(member)
            if only is not None and name not in only:
                continue
            n_bytes += member.file_size
            if member.file_size > _MAX_COMPRESSION * (member.compress_size + 1):
                raise ValueError(f"array {name} would take {member.file_size} bytes")
            check_expansion(n_bytes, of_bytes)
            if name in arrays:
                raise ValueError(f"array {name} is there twice")
            with archive.open(member) as content:
                arrays[name] = _read_array(name, cast(zipfile.ZipExtFile, content), member.file_size)
    return arrays


def _is_array(member: zipfile.ZipInfo) -> bool:
    return member.filename.endswith(".npy")


def _array_name(member: zipfile.ZipInfo) -> str:
    return member.filename.removesuffix(".npy")


def _read_array(name: str, content: io.BufferedIOBase, n_bytes: int) -> np.ndarray:
    """The array of a file, or a member of an archive, of this size. NumPy's own reader believes the header's shape."""
    version = np.lib.format.read_magic(content)
    readers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    if version not in readers:
        raise ValueError(f"array {name} is of version {version} of the format")
    shape, by_columns, dtype = readers[version](content)
    if dtype.kind not in _PLAIN or dtype.itemsize == 0:
        raise ValueError(f"array {name} is of type {dtype}")
    declared = content.tell() + math.prod(shape) * dtype.itemsize
    if min(shape, default=0) < 0 or declared != n_bytes:
        raise ValueError(f"array {name} of shape {shape} and type {dtype} takes {declared} bytes, there are {n_bytes}")
    if math.prod(shape) == 0 and max(shape) > _MAX_EMPTY_ROWS:
        raise ValueError(f"array {name} has the shape {shape}")
    numbers = np.frombuffer(content.read(), dtype)
    return numbers.reshape(shape, order="F" if by_columns else "C").copy()


def checked(arrays: Mapping[str, np.ndarray], name: str, kind: Kind, *shape: int | None) -> np.ndarray:
    """One of the arrays.

    Args:
        arrays: of a file.
        name: of the array wanted.
        kind: numbers may be whole ones.
        shape: wanted; None: any length.

    Raises:
        ValueError: it is missing, of another kind or shape; the caller names the file.
    """
    if name not in arrays:
        raise ValueError(f"the array {name} is missing")
    array = arrays[name]
    if array.dtype.kind not in _KINDS[kind]:
        raise ValueError(f"array {name} must be {kind}, it is of type {array.dtype}")
    fits = array.ndim == len(shape) and all(n in (None, m) for n, m in zip(shape, array.shape, strict=True))
    if not fits:
        wanted = ", ".join("any" if n is None else str(n) for n in shape)
        raise ValueError(f"array {name} must be ({wanted}), got {array.shape}")
    return array


def text(arrays: Mapping[str, np.ndarray], name: str) -> str:
    """An array that is one text. Raises ValueError as checked does."""
    return str(checked(arrays, name, "texts"))


def texts(arrays: Mapping[str, np.ndarray], name: str) -> tuple[str, ...]:
    """An array that is a list of texts. Raises ValueError as checked does."""
    return tuple(checked(arrays, name, "texts", None).tolist())


def write_arrays(path: Path, arrays: Mapping[str, Any], *, compressed: bool = True) -> None:
    """Replace a file by an npz of these arrays that needs no pickle, whole or not at all.

    Raises:
        OSError: it cannot be written; the message names it.
    """
    content = io.BytesIO()
    write = np.savez_compressed if compressed else np.savez
    write(content, allow_pickle=False, **arrays)
    write_bytes(path, content.getvalue())
