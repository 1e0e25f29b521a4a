"""Names of cameras in files: their natural order, and which name of the keypoints is which of the calibration."""

from __future__ import annotations

import re
from collections.abc import Iterable


def natural_key(name: str) -> list[tuple[int, str]]:
    """Sort key that puts cam_2 before cam_10."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", name) if part]


def match_cameras(found: Iterable[str], rig_names: Iterable[str], *, ignore_others: bool = False) -> dict[str, str]:
    """For each camera of the rig, the name by which the keypoints call it.

    Case, underscores, hyphens, dots, blanks and a final ``_json`` do not count: cam01_json is cam_01. Neither does what
    Pose2Sim puts around the name in its intrinsics: int_cam01_img is cam_01 too.

    Args:
        ignore_others: whether keypoints may be of cameras that the rig lacks.

    Raises:
        ValueError: a camera is in one of the two only, or two names of one side are the same; the message names them.
    """
    keypoints, rig = _by_plain_name(found, "keypoints"), _by_plain_name(rig_names, "calibration")
    lacking = [name for plain, name in keypoints.items() if plain not in rig]
    unused = [name for plain, name in rig.items() if plain not in keypoints]
    kept = [name for name in rig.values() if name not in unused]
    problems = []
    if lacking and not (ignore_others and kept):
        problems.append(
            f"the calibration lacks camera {', '.join(lacking)} of the keypoints; it has {', '.join(rig.values())}"
            + ("" if kept else ". They have no camera in common: is it the calibration of this recording?")
        )
    if unused and (kept or not lacking):
        problems.append(
            f"camera {', '.join(unused)} of the calibration has no keypoints"
            + (f"; leave it out with --cameras {' '.join(kept)}, in Python with rig.subset({kept})" if kept else "")
        )
    if problems:
        raise ValueError("; ".join(problems))
    return {name: keypoints[plain] for plain, name in rig.items()}


def seen_cameras(found: Iterable[str], rig_names: Iterable[str]) -> tuple[str, ...]:
    """Those cameras of the rig that the keypoints have, in its order; compared as match_cameras does."""
    known = {_plain(name) for name in found}
    return tuple(name for name in rig_names if _plain(name) in known)


def named_cameras(wanted: Iterable[str], known: Iterable[str]) -> dict[str, str]:
    """For each camera that is wanted, what it is called among those that are known; compared as match_cameras does.

    Raises:
        ValueError: one is not among them, or two names of one side are the same; the message names them.
    """
    by_plain_name = _by_plain_name(known, "file")
    names = {name: by_plain_name.get(plain) for plain, name in _by_plain_name(wanted, "recording").items()}
    lacking = [name for name, found in names.items() if found is None]
    if lacking:
        raise ValueError(f"it has no camera {', '.join(lacking)}, only {', '.join(by_plain_name.values())}")
    return {name: found for name, found in names.items() if found is not None}


def _plain(name: str) -> str:
    name = re.sub(r"^(?:int|ext)_(.+)_img$", r"\1", name, flags=re.IGNORECASE)
    return re.sub(r"[_\-.\s]", "", re.sub(r"_json$", "", name, flags=re.IGNORECASE).casefold())


def _by_plain_name(names: Iterable[str], where: str) -> dict[str, str]:
    plain_names: dict[str, str] = {}
    for name in names:
        plain = _plain(name)
        if plain in plain_names:
            raise ValueError(f"cameras {plain_names[plain]} and {name} of the {where} cannot be told apart")
        plain_names[plain] = name
    return plain_names
