"""The bytes of a file, with errors that name it also when a disk fails in the middle of it; and what is in them."""

from __future__ import annotations

import dataclasses
import io
import json
import math
import os
import types
import typing
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import Any

from fgpose.plain_files import (
    MAX_EMPTY_LINES,
    MAX_FILE_GB,
    MAX_JSON_EXPANSION,
    MAX_LINE,
    check_expansion,
    max_text_bytes,
    naming,
    open_plain,
)

_PART_BYTES = 1 << 20  # a file without an end, as some of /proc are, is noticed this much too late at most
_SEPARATORS = " \t,;\r\n"
_UTF_16 = (b"\xff\xfe", b"\xfe\xff")
# In Python, with the reference to it: an empty list, a table with a key, a number.
_LIST_BYTES, _TABLE_BYTES, _VALUE_BYTES = 64, 200, 32


def read_content(path: Path, max_bytes: int | None = None) -> bytes:
    """Everything in a file, text as UTF-8.

    Args:
        path: the file.
        max_bytes: None: max_text_bytes.

    Raises:
        ValueError: it has more bytes than this, perhaps no end; the caller names it.
        OSError: it cannot be read; the message names it.
    """
    most = max_text_bytes() if max_bytes is None else max_bytes
    with naming(path), open_plain(path) as file:
        n_bytes = os.fstat(file.fileno()).st_size
        parts = [file.read(n_bytes + 1)] if n_bytes <= most else []
        n_read = n_bytes
        # Where the size is not what is said, as in /proc, and of files that grow.
        while n_read <= most and (part := file.read(_PART_BYTES)):
            parts.append(part)
            n_read += len(part)
    if n_read > most:
        remedy = "" if max_bytes else f"; {MAX_FILE_GB} raises the limit, to a quarter of it"
        raise ValueError(f"it has more than {most} bytes{remedy}")
    content = b"".join(parts)
    if content.startswith(_UTF_16):  # what PowerShell's > writes
        return content.decode("utf-16").encode()
    return content


def text_lines(content: bytes) -> Iterator[str]:
    """The lines of a text, without their ends, one at a time.

    Raises:
        ValueError: it is no UTF-8, a line is longer than MAX_LINE, or more than MAX_EMPTY_LINES follow each other that
            have nothing but separators; the caller names the file.
    """
    text = io.TextIOWrapper(io.BytesIO(content), "utf-8-sig")
    number = n_empty = 0
    while line := text.readline(MAX_LINE):
        number += 1
        n_empty = 0 if line.strip(_SEPARATORS) else n_empty + 1
        if n_empty > MAX_EMPTY_LINES:
            raise ValueError(f"line {number} is one of more than {MAX_EMPTY_LINES} empty lines")
        if len(line) == MAX_LINE:
            raise ValueError(f"line {number} has {MAX_LINE} characters or more")
        yield line.removesuffix("\n")


def parse_json(content: str | bytes, *, distinct: bool = False) -> Any:
    """The document in a text as JSON.

    Args:
        content: the text.
        distinct: whether no table may have a name twice; else the last counts.

    Raises:
        ValueError: it is damaged, nested too deeply, or would take too much memory; the caller names the file.
    """
    encoded = content.encode() if isinstance(content, str) else content
    n_bytes = _LIST_BYTES * encoded.count(b"[") + _TABLE_BYTES * encoded.count(b"{")
    check_expansion(n_bytes + _VALUE_BYTES * encoded.count(b","), len(encoded), MAX_JSON_EXPANSION)
    try:
        return json.loads(content, object_pairs_hook=_distinct if distinct else None)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None


def _distinct(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table = dict(pairs)
    if len(table) < len(pairs):
        names = [name for name, _ in pairs]
        raise ValueError(f"{next(name for name in names if names.count(name) > 1)} is in it twice")
    return table


def first_bytes(path: Path, n_bytes: int) -> bytes:
    """The beginning of a file, all of it if it is shorter. Raises OSError, which names it, if it cannot be read."""
    with naming(path), open_plain(path) as file:
        return file.read(n_bytes)


def last_bytes(path: Path, n_bytes: int) -> bytes:
    """The end of a file, all of it if it is shorter. Raises OSError, which names it, if it cannot be read."""
    with naming(path), open_plain(path) as file:
        file.seek(max(0, os.fstat(file.fileno()).st_size - n_bytes))
        return file.read(n_bytes)


@contextmanager
def damage(said: str) -> Iterator[None]:
    """Whatever is raised meanwhile is said as damage: zipfile, zlib, NumPy and MessagePack raise a dozen kinds of
    exceptions, depending on the byte that is wrong.

    Args:
        said: before the reason: "a damaged npz".

    Raises:
        ValueError: there was one; the caller names the file.
    """
    try:
        yield
    except Exception as error:
        raise ValueError(f"{said}: {str(error) or type(error).__name__}") from None


def converted(kind: Any, value: Any, name: str) -> Any:
    """A value as its annotation says; a field that is absent keeps its default.

    Args:
        kind: a dataclass, tuple[X, ...], Mapping[str, X], X | None, float, int, str or a StrEnum.
        value: as JSON or TOML gives it.
        name: what it is called in the file.

    Raises:
        ValueError: it is something else; the message has the name.
    """
    if dataclasses.is_dataclass(kind):
        known = typing.get_type_hints(typing.cast(type, kind))
        if not isinstance(value, dict) or not value.keys() <= known.keys():
            raise ValueError(f"{name}: a table of {', '.join(known)} is needed")
        values = {key: converted(known[key], each, f"{name}.{key}") for key, each in value.items()}
        try:
            return typing.cast(type, kind)(**values)
        except TypeError:
            raise ValueError(f"{name}: something is missing") from None
    if isinstance(kind, types.UnionType):
        return None if value is None else converted(typing.get_args(kind)[0], value, name)
    if typing.get_origin(kind) is tuple and isinstance(value, list):
        return tuple(converted(typing.get_args(kind)[0], each, name) for each in value)
    if typing.get_origin(kind) is Mapping and isinstance(value, dict):
        return {key: converted(typing.get_args(kind)[1], each, name) for key, each in value.items()}
    if kind is float and type(value) in (int, float) and abs(value) < 1e300 and math.isfinite(value):
        return float(value)
    if kind in (int, str) and type(value) is kind:
        return value
    if isinstance(kind, type) and issubclass(kind, StrEnum) and value in list(kind):
        return kind(value)
    raise ValueError(f"{name}: it has {str(value)[:40]!r}")
