"""The summary of a dataclass by its fields: their names carry the unit, their annotations what an array is of."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import Field, fields, is_dataclass
from enum import Enum
from typing import Any

import numpy as np

from fgpose.notebook.summary import Summary, counted, listed, percent
from fgpose.shown import Shown

_UNITS = {"m": "m", "mm": "mm", "px": "px", "px2": "px²", "deg": "deg", "s": "s"}
_VERDICTS = ("grade", "ending")
_SHAPE = re.compile(r"'([^']*)'|\"([^\"]*)\"")
_WIDTH = 90  # of a text among others

SummaryOf = Callable[[Any], Summary]


def by_fields(shown: Any, summary: SummaryOf) -> Summary:
    """Its verdict and what it is about; one fact for each field, a column for each that has a number for each camera.

    Args:
        shown: a dataclass.
        summary: of things that it holds.
    """
    names = _cameras(shown)
    facts, columns, held = dict[str, str](), dict[str, np.ndarray](), dict[str, str]()
    for word, unit, value, shape in _fields(shown):
        if isinstance(value, np.ndarray):
            facts.setdefault(word, _array(value, unit, shape, names))
            if shape == ["camera"] and len(value) == len(names):
                columns.setdefault(f"{word} [{unit}]" if unit else word, value)
        elif isinstance(value, Shown):
            held.setdefault(word, summary(value).title.partition(": ")[2])
        else:
            facts.setdefault(word, _plain(value, unit))
    # Why it is not better comes first.
    facts = {word: fact for word, fact in ({"findings": ""} | facts | held).items() if fact and word != "rig"}
    verdicts = [value.value for each in _VERDICTS if isinstance(value := getattr(shown, each, None), Enum)]
    about = held.get("rig") or _sizes(shown) or " ".join(next(iter(facts.items()), ()))
    cells = [_cells(column) for column in columns.values()]
    rows = [(name, *(column[i] for column in cells)) for i, name in enumerate(names)]
    title = f"{type(shown).__name__}: {', '.join([*verdicts, about])}"
    return Summary(title, facts, ("camera", *columns), rows if columns else ())


def _fields(shown: Any, prefix: str = "") -> Iterator[tuple[str, str, Any, list[str]]]:
    """Word, unit, value and shape of each; those of a part of it (of its standard deviations, of one of two results) as
    its own."""
    for field in fields(shown):
        value = getattr(shown, field.name)
        if field.name.startswith("_") or field.name in _VERDICTS or "_T_" in field.name:
            continue
        word, unit = _word_and_unit(field.name)
        if is_dataclass(value) and not isinstance(value, type) and _is_part(value):
            yield from _fields(value, "" if hasattr(value, "rig") else f"{word.removesuffix('s')} of ")
        else:
            yield prefix + word, unit, value, _shape(field)


def _is_part(value: Any) -> bool:
    return any(_shape(field) == ["camera"] for field in fields(value)) and not hasattr(value, "camera_names")


def _word_and_unit(name: str) -> tuple[str, str]:
    words = name.removeprefix("n_").removeprefix("camera_").split("_")
    unit = _UNITS.get(words[-1], "") if len(words) > 1 else ""
    return " ".join(words[:-1] if unit else words), unit


def _shape(field: Field[Any]) -> list[str]:
    """What the axes of an array are, by its annotation."""
    found = _SHAPE.search(str(field.type)) if "np.ndarray" in str(field.type) else None
    return (found[1] or found[2]).split() if found else []


def _cameras(shown: Any) -> tuple[str, ...]:
    rig = getattr(shown, "rig", None)
    return getattr(shown, "camera_names", ()) if rig is None else rig.names


def _sizes(shown: Any) -> str:
    """How many frames, cameras, joints its arrays have."""
    sizes: dict[str, int] = {}
    for field in fields(shown):
        value = getattr(shown, field.name)
        if isinstance(value, np.ndarray):
            sizes |= {axis: size for axis, size in zip(_shape(field), value.shape, strict=False) if axis.isalpha()}
    return ", ".join(counted(size, axis) for axis, size in sizes.items())


def _array(value: np.ndarray, unit: str, shape: list[str], names: tuple[str, ...]) -> str:
    """Of numbers their range, or their median where they are many; of points how many are known."""
    if value.dtype == bool:
        return listed([name for name, is_so in zip(names, value.tolist(), strict=False) if is_so])
    if not np.issubdtype(value.dtype, np.floating) or not value.size:
        return ""
    known = np.isfinite(value)
    if shape[-1:] and shape[-1].isdigit():
        return f"{percent(float(known.all(axis=-1).mean()))} known"
    numbers = value[known]
    if not numbers.size or not numbers.any():
        return ""
    if value.ndim > 1:
        return f"{np.median(numbers):.3g} {unit}".strip() + " (median)"
    low, high = _rounded([numbers.min(), numbers.max()])
    return f"{low if low == high else f'{low} to {high}'} {unit}".strip()


def _plain(value: object, unit: str) -> str:
    if value is None or value is False:
        return ""
    if isinstance(value, bool):
        return "yes"
    if isinstance(value, float):
        return f"{value:.3g} {unit}".strip() if np.isfinite(value) and value else ""
    if isinstance(value, int):
        return f"{value:,}"
    if isinstance(value, str):
        return value
    if isinstance(value, Enum):
        return str(value.value)
    if isinstance(value, tuple | list) and value and all(isinstance(each, str) for each in value):
        return listed(value)
    if isinstance(value, tuple | list | Mapping):
        said = [str(getattr(each, "text", "")) for each in value]
        return f"{len(value):,}" + (f": {said[0][:_WIDTH]}" if said[0] else "") if value else ""
    return str(getattr(value, "text", ""))


def _cells(column: np.ndarray) -> list[str]:
    if column.dtype == bool:
        return ["yes" if each else "no" for each in column]
    return _rounded(column.tolist())


def _rounded(numbers: Sequence[float]) -> list[str]:
    """To the digits that the largest has, three of which count."""
    largest = max((abs(each) for each in numbers if np.isfinite(each)), default=0.0)
    digits = max(0, 2 - math.floor(math.log10(largest))) if largest else 0
    return [f"{each:.{digits}f}" if np.isfinite(each) else "-" for each in numbers]
