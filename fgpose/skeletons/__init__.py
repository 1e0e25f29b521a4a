"""The skeletons that come with fgpose, by their names."""

from __future__ import annotations

import reprlib
from functools import cache
from importlib import resources
from typing import Any

from fgpose.config import parse_toml
from fgpose.shown.unknown_names import nearest, plain
from fgpose.skeleton import LIMBS, BodyPart, Skeleton

_KEYS = {"name", "joints", "root", "bones", "lines", "left_right", "limbs", "parts"}
_KEYS_OF_PART = {"joints", "hangs_on", "carried_by", "relative_sigma"}


@cache
def builtin_skeletons() -> tuple[str, ...]:
    """Names of the skeletons that come with fgpose."""
    files = resources.files("fgpose").joinpath("skeletons").iterdir()
    return tuple(sorted(file.name.removesuffix(".toml") for file in files if file.name.endswith(".toml")))


def named_skeleton(skeleton: Skeleton | str) -> Skeleton:
    """A built-in skeleton by its name, as other programs write it too (BODY_25, halpe26, COCO). A skeleton is itself.

    Raises:
        ValueError: no built-in skeleton has this name; the message says which may be meant.
        TypeError: it is neither.
    """
    if isinstance(skeleton, Skeleton):
        return skeleton
    if not isinstance(skeleton, str):
        raise TypeError(f"a skeleton or its name is needed, got {reprlib.repr(skeleton)}")
    return _load(_found(skeleton))


def _found(name: str) -> str:
    """The one that is called so, but for case and separators; or alone but for its number; or alone begins so."""
    wanted, known = plain(name), {plain(own): own for own in builtin_skeletons()}
    begin_so = [own for each, own in known.items() if wanted and each.startswith(wanted)]
    but_for_number = [own for own in begin_so if plain(own)[len(wanted) :][:1].isdigit()]
    found = [known[wanted]] if wanted in known else but_for_number or begin_so
    if len(found) != 1:
        meant = found or nearest(name, builtin_skeletons(), n_most=2)
        hint = f"did you mean {' or '.join(meant)}? There are" if meant else "give a TOML file or one of"
        raise ValueError(f"no skeleton {name!r}: {hint} {', '.join(builtin_skeletons())}")
    return found[0]


@cache
def _load(name: str) -> Skeleton:
    text = resources.files("fgpose").joinpath("skeletons", f"{name}.toml").read_text(encoding="utf-8")
    return parse_skeleton(parse_toml(text))


def parse_skeleton(table: dict[str, Any]) -> Skeleton:
    """Of a skeleton file. Raises ValueError that says what is wrong with it."""
    unknown = set(table) - _KEYS
    if unknown:
        raise ValueError(f"unknown key {min(unknown)}")
    missing = {"name", "joints", "root", "bones"} - set(table)
    if missing:
        raise ValueError(f"{', '.join(sorted(missing))} is missing")
    if not isinstance(table["name"], str):
        raise ValueError("name must be a text")
    joints = tuple(_names("joints", table["joints"]))
    limbs = table.get("limbs", {})
    if not isinstance(limbs, dict):
        raise ValueError("limbs must be a table")
    if set(limbs) - set(LIMBS):
        raise ValueError(f"limbs are {', '.join(LIMBS)}, got {', '.join(limbs)}")

    parts = table.get("parts", {})
    if not isinstance(parts, dict):
        raise ValueError("parts must be a table")

    def pairs(what: str, rows: Any) -> tuple[tuple[int, int], ...]:
        return _pairs(what, rows, joints)

    return Skeleton(
        name=table["name"],
        joints=joints,
        bones=pairs("bones", table["bones"]),
        root=_indices("root", table["root"], joints),
        left_right=pairs("left_right", table.get("left_right", [])),
        limbs=pairs("limbs", [limbs[limb] for limb in LIMBS if limb in limbs]),
        lines=pairs("lines", table.get("lines", [])),
        parts=[_part(name, of, joints) for name, of in parts.items()],
    )


def _part(name: str, table: Any, joints: tuple[str, ...]) -> BodyPart:
    what = f"parts.{name}"
    if not isinstance(table, dict) or not {"joints", "hangs_on"} <= set(table) <= _KEYS_OF_PART:
        raise ValueError(f"{what} needs joints and hangs_on, and may have carried_by and relative_sigma")
    relative_sigma = table.get("relative_sigma", 1.0)
    if type(relative_sigma) not in (int, float):
        raise ValueError(f"{what}.relative_sigma must be a number")
    return BodyPart(
        name,
        joints=_indices(f"{what}.joints", table["joints"], joints),
        hangs_on=_pairs(f"{what}.hangs_on", [table["hangs_on"]], joints)[0],
        carried_by=_indices(f"{what}.carried_by", table.get("carried_by", []), joints),
        relative_sigma=float(relative_sigma),
    )


def _pairs(what: str, rows: Any, joints: tuple[str, ...]) -> tuple[tuple[int, int], ...]:
    if not isinstance(rows, list):
        raise ValueError(f"{what} must be a list of pairs of joints")
    for row in rows:
        if not isinstance(row, list) or len(row) != 2:
            raise ValueError(f"{what}: a pair of joints is needed, got {reprlib.repr(row)}")
    return tuple((a, b) for a, b in (_indices(what, row, joints) for row in rows))


def _indices(what: str, names: Any, joints: tuple[str, ...]) -> tuple[int, ...]:
    for name in _names(what, names):
        if name not in joints:
            raise ValueError(f"{name!r} is not one of the joints")
    return tuple(joints.index(name) for name in names)


def _names(what: str, value: Any) -> list[str]:
    if not isinstance(value, list) or not all(isinstance(name, str) for name in value):
        raise ValueError(f"{what} must be a list of joints, got {reprlib.repr(value)}")
    return value
