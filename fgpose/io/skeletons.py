"""Skeleton files (TOML): the built-in ones and a user's own, in one format."""

from __future__ import annotations

import reprlib
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from fgpose.config import parse_toml
from fgpose.io.content import read_content
from fgpose.plain_files import MAX_SETTINGS_BYTES, naming
from fgpose.shown.unknown_names import nearest, plain
from fgpose.skeleton import LIMBS, BodyPart, Skeleton

_KEYS = {"name", "joints", "root", "bones", "lines", "left_right", "limbs", "parts"}
_KEYS_OF_PART = {"joints", "hangs_on", "carried_by", "relative_sigma"}


@cache
def builtin_skeletons() -> tuple[str, ...]:
    """Names of the skeletons that come with fgpose."""
    files = resources.files("fgpose").joinpath("skeletons").iterdir()
    return tuple(sorted(file.name.removesuffix(".toml") for file in files if file.name.endswith(".toml")))


def load_skeleton(name_or_path: str | Path) -> Skeleton:
    """A built-in skeleton by name, or a user's own from a TOML file of the same form (see fgpose/skeletons/).

    Names are found as other programs write them: BODY_25, halpe26, COCO.

    Raises:
        ValueError: no built-in skeleton has this name, or the file is not a skeleton; the message says where.
    """
    if str(name_or_path) in builtin_skeletons() or not Path(name_or_path).is_file():
        return _load_builtin(_builtin(str(name_or_path)))
    with naming(name_or_path, "not a skeleton"):
        content = read_content(Path(name_or_path), MAX_SETTINGS_BYTES)
        return _parse(parse_toml(content.decode("utf-8")))


def as_skeleton(skeleton: Skeleton | str | Path) -> Skeleton:
    """A skeleton itself, or that of a name or a file, as load_skeleton."""
    return skeleton if isinstance(skeleton, Skeleton) else load_skeleton(skeleton)


def _builtin(name: str) -> str:
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
def _load_builtin(name: str) -> Skeleton:
    text = resources.files("fgpose").joinpath("skeletons", f"{name}.toml").read_text(encoding="utf-8")
    return _parse(parse_toml(text))


def _parse(table: dict[str, Any]) -> Skeleton:
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

    def indices(what: str, names: Any) -> tuple[int, ...]:
        for name in _names(what, names):
            if name not in joints:
                raise ValueError(f"{name!r} is not one of the joints")
        return tuple(joints.index(name) for name in names)

    def pairs(what: str, rows: Any) -> tuple[tuple[int, int], ...]:
        if not isinstance(rows, list):
            raise ValueError(f"{what} must be a list of pairs of joints")
        for row in rows:
            if not isinstance(row, list) or len(row) != 2:
                raise ValueError(f"{what}: a pair of joints is needed, got {reprlib.repr(row)}")
        return tuple((a, b) for a, b in (indices(what, row) for row in rows))

    def part(name: str, of: Any) -> BodyPart:
        if not isinstance(of, dict) or not {"joints", "hangs_on"} <= set(of) <= _KEYS_OF_PART:
            raise ValueError(f"parts.{name} needs joints and hangs_on, and may have carried_by and relative_sigma")
        relative_sigma = of.get("relative_sigma", 1.0)
        if type(relative_sigma) not in (int, float):
            raise ValueError(f"parts.{name}.relative_sigma must be a number")
        hangs_on = pairs(f"parts.{name}.hangs_on", [of["hangs_on"]])[0]
        own = (indices(f"parts.{name}.{what}", of.get(what, [])) for what in ("joints", "carried_by"))
        return BodyPart(name, next(own), hangs_on, next(own), float(relative_sigma))

    parts = table.get("parts", {})
    if not isinstance(parts, dict):
        raise ValueError("parts must be a table")
    return Skeleton(
        name=table["name"],
        joints=joints,
        bones=pairs("bones", table["bones"]),
        root=indices("root", table["root"]),
        left_right=pairs("left_right", table.get("left_right", [])),
        limbs=pairs("limbs", [limbs[limb] for limb in LIMBS if limb in limbs]),
        lines=pairs("lines", table.get("lines", [])),
        parts=[part(name, of) for name, of in parts.items()],
    )


def _names(what: str, value: Any) -> list[str]:
    if not isinstance(value, list) or not all(isinstance(name, str) for name in value):
        raise ValueError(f"{what} must be a list of joints, got {reprlib.repr(value)}")
    return value
