"""Tables of JSON or TOML as dataclasses: each field is checked against its annotation."""

from __future__ import annotations

import dataclasses
import math
import types
import typing
from collections.abc import Mapping
from enum import StrEnum
from typing import Any


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
