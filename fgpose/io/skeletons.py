"""Skeleton files (TOML): the built-in ones and a user's own, in one format."""

from __future__ import annotations

import tomllib
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from fgpose.skeleton import LIMBS, Skeleton

_KEYS = {"name", "joints", "root", "bones", "lines", "left_right", "limbs"}


@cache
def builtin_skeletons() -> tuple[str, ...]:
    """Names of the skeletons that come with fgpose."""
    files = resources.files("fgpose").joinpath("skeletons").iterdir()
    return tuple(sorted(file.name.removesuffix(".toml") for file in files if file.name.endswith(".toml")))


def load_skeleton(name_or_path: str | Path) -> Skeleton:
    """A built-in skeleton by name, or a user's own from a TOML file of the same form (see fgpose/skeletons/).

    Raises:
        ValueError: no built-in skeleton has this name, or the file is not a skeleton; the message says where.
    """
    if str(name_or_path) in builtin_skeletons():
        return _load_builtin(str(name_or_path))
    if not Path(name_or_path).is_file():
        raise ValueError(
            f"no skeleton {str(name_or_path)!r}: give a TOML file or one of {', '.join(builtin_skeletons())}"
        )
    try:
        return _parse(tomllib.loads(Path(name_or_path).read_text(encoding="utf-8")))
    except (tomllib.TOMLDecodeError, ValueError, TypeError, KeyError) as error:
        raise ValueError(f"{name_or_path}: not a skeleton: {error}") from None


@cache
def _load_builtin(name: str) -> Skeleton:
    text = resources.files("fgpose").joinpath("skeletons", f"{name}.toml").read_text(encoding="utf-8")
    return _parse(tomllib.loads(text))


def _parse(table: dict[str, Any]) -> Skeleton:
    unknown = set(table) - _KEYS
    if unknown:
        raise ValueError(f"unknown key {', '.join(sorted(unknown))}")
    missing = {"name", "joints", "root", "bones"} - set(table)
    if missing:
        raise ValueError(f"{', '.join(sorted(missing))} is missing")
    joints = tuple(table["joints"])
    limbs = table.get("limbs", {})
    if set(limbs) - set(LIMBS):
        raise ValueError(f"limbs are {', '.join(LIMBS)}, got {', '.join(limbs)}")

    def indices(names: list[str]) -> tuple[int, ...]:
        for name in names:
            if name not in joints:
                raise ValueError(f"{name!r} is not one of the joints")
        return tuple(joints.index(name) for name in names)

    def pairs(rows: list[list[str]]) -> tuple[tuple[int, int], ...]:
        for row in rows:
            if len(row) != 2:
                raise ValueError(f"a pair of joints is needed, got {row}")
        return tuple((a, b) for a, b in map(indices, rows))

    return Skeleton(
        name=table["name"],
        joints=joints,
        bones=pairs(table["bones"]),
        root=indices(table["root"]),
        left_right=pairs(table.get("left_right", [])),
        limbs=pairs([limbs[limb] for limb in LIMBS if limb in limbs]),
        lines=pairs(table.get("lines", [])),
    )
