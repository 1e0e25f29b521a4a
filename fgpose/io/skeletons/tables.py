"""A skeleton inside of another file (JSON): joints by their numbers."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Any

from fgpose.io.content import parse_json
from fgpose.skeleton import BodyPart, Skeleton

_PAIRS = ("bones", "left_right", "limbs", "lines")
_FIELDS = ("name", "joints", "bones", "root", "left_right", "limbs", "lines")


def skeleton_table(skeleton: Skeleton) -> dict[str, Any]:
    """What skeleton_of reads; parts are there if it has any."""
    table = {name: getattr(skeleton, name) for name in _FIELDS}
    return table | ({"parts": [asdict(part) for part in skeleton.parts]} if skeleton.parts else {})


def skeleton_of(table: Any) -> Skeleton:
    """The skeleton of such a table. Raises ValueError: it is none; the message says why."""
    if not isinstance(table, dict):
        raise ValueError("a table is needed")
    missing = [name for name in _FIELDS if name not in table]
    if missing or not isinstance(table["name"], str):
        raise ValueError(f"{', '.join(missing) or 'its name'} is missing")
    return Skeleton(
        table["name"],
        joints=joint_names(table["joints"]),
        root=joint_indices(table["root"]),
        parts=_parts(table.get("parts", [])),
        **{name: _pairs(table[name]) for name in _PAIRS},
    )


def skeleton_to_json(skeleton: Skeleton) -> str:
    """All of a skeleton, as skeleton_from_json reads it."""
    return json.dumps(skeleton_table(skeleton))


def skeleton_from_json(text: str) -> Skeleton:
    """Raises ValueError: the text is not what skeleton_to_json writes, or no skeleton."""
    return skeleton_of(parse_json(text))


def joint_names(value: Any) -> tuple[str, ...]:
    """Raises ValueError: it is no list of names."""
    if not isinstance(value, list) or not all(isinstance(name, str) for name in value):
        raise ValueError("a list of names is needed")
    return tuple(value)


def joint_indices(value: Any) -> tuple[int, ...]:
    """Raises ValueError: it is no list of whole numbers."""
    if not isinstance(value, list) or not all(type(index) is int for index in value):
        raise ValueError("the numbers of joints are needed")
    return tuple(value)


def _pairs(value: Any) -> tuple[tuple[int, int], ...]:
    if not isinstance(value, list) or not all(isinstance(pair, list) and len(pair) == 2 for pair in value):
        raise ValueError("a list of pairs of joints is needed")
    return tuple((a, b) for a, b in map(joint_indices, value))


def _parts(value: Any) -> tuple[BodyPart, ...]:
    try:
        return tuple(
            BodyPart(
                str(row["name"]),
                joint_indices(row["joints"]),
                _pairs([row["hangs_on"]])[0],
                joint_indices(row["carried_by"]),
                float(row["relative_sigma"]),
            )
            for row in value
        )
    except (TypeError, KeyError) as error:
        raise ValueError(f"its parts are damaged: {error}") from None
