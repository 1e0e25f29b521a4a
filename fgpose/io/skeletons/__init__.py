"""Skeleton files (TOML): the built-in ones and a user's own, in one format."""

from __future__ import annotations

from pathlib import Path

from fgpose.config import parse_toml
from fgpose.io.content import read_content
from fgpose.plain_files import MAX_SETTINGS_BYTES, naming
from fgpose.skeleton import Skeleton
from fgpose.skeletons import builtin_skeletons as builtin_skeletons
from fgpose.skeletons import named_skeleton, parse_skeleton


def load_skeleton(name_or_path: str | Path) -> Skeleton:
    """A built-in skeleton by name, or a user's own from a TOML file of the same form (see fgpose/skeletons/).

    Names are found as other programs write them: BODY_25, halpe26, COCO.

    Raises:
        ValueError: no built-in skeleton has this name, or the file is not a skeleton; the message says where.
    """
    if str(name_or_path) in builtin_skeletons() or not Path(name_or_path).is_file():
        return named_skeleton(str(name_or_path))
    with naming(name_or_path, "not a skeleton"):
        content = read_content(Path(name_or_path), MAX_SETTINGS_BYTES)
        return parse_skeleton(parse_toml(content.decode("utf-8")))


def as_skeleton(skeleton: Skeleton | str | Path) -> Skeleton:
    """A skeleton itself, or that of a name or a file, as load_skeleton."""
    return skeleton if isinstance(skeleton, Skeleton) else load_skeleton(skeleton)
