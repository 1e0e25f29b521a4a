"""Which joint a name means: RHip, RightHip and right_hip are the same, in skeletons and in files of markers."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence

import numpy as np
from jaxtyping import Int

_CAMEL_CASE = re.compile(r"([LR](?=[A-Z][a-z])|Left|Right)?((?:[A-Z][a-z]+\d*)+)")
_SIDES = {"L": "left_", "R": "right_", "Left": "left_", "Right": "right_", None: ""}
# Pose2Sim calls the middle of the hips Hip in its Halpe models and CHip or MidHip in others.
_PELVIS = ("Hip", "MidHip", "CHip")
# Of a side: what Pose2Sim's models call otherwise. Its fingers are the joints beside the palm (ids 93, 96 and 108 of
# COCO-WholeBody in its skeletons.py), which BlazePose calls so too, and its big toe is the tip of BlazePose's foot.
_IN_MODELS = {"foot_index": "big_toe", "thumb_mcp": "thumb", "index_mcp": "index", "pinky_mcp": "pinky"}


def joint_of_marker(marker: str) -> str:
    """fgpose's name of a marker named as Pose2Sim and OpenPose do: RHip is right_hip. Other names stay as they are."""
    if marker in _PELVIS:
        return "pelvis"
    match = _CAMEL_CASE.fullmatch(marker)
    if match is None:
        return marker
    words = re.findall(r"[A-Z][a-z]+\d*", match[2])
    return _SIDES[match[1]] + "_".join(words).lower()


def marker_of_joint(joint: str) -> str:
    """Name of a joint as Pose2Sim and its OpenSim models have it: right_hip is RHip, pelvis is Hip."""
    if joint == "pelvis":
        return _PELVIS[0]
    side = {"left": "L", "right": "R"}.get(joint.split("_")[0], "")
    words = joint.split("_")[1:] if side else joint.split("_")
    marker = side + "".join(word.capitalize() for word in words)
    return marker if joint_of_marker(marker) == joint else joint


def meanings(joints: Sequence[str]) -> tuple[str, ...]:
    """fgpose's name of each joint of one body, all different: where several mean the same, one that is called so keeps
    the name, and the others their own."""
    meant = [joint_of_marker(joint) for joint in joints]
    times = Counter(meant)
    return tuple(meaning if times[meaning] == 1 else joint for joint, meaning in zip(joints, meant, strict=True))


def marker_names(joints: Sequence[str]) -> tuple[str, ...]:
    """The marker of each joint of one body, named as in Pose2Sim's OpenSim models, all different: where several would
    have the same one, they keep their own names.

    That is marker_of_joint, but for the toe of BlazePose (LBigToe), the hands of whole bodies (LIndex is the joint of
    the index finger beside the palm), and the pelvis of a body without a head (CHip, as in body_25).
    """
    modelled = _as_modelled(joints)
    markers = [marker_of_joint(joint) for joint in modelled]
    if "head" not in modelled:
        markers = ["CHip" if joint == "pelvis" else marker for joint, marker in zip(modelled, markers, strict=True)]
    times = Counter(markers)
    return tuple(marker if times[marker] == 1 else joint for joint, marker in zip(joints, markers, strict=True))


def _as_modelled(joints: Sequence[str]) -> tuple[str, ...]:
    """As meanings, and joints that Pose2Sim's models call otherwise by that name, where it is not of another joint."""
    meant = meanings(joints)

    def modelled(joint: str) -> str:
        side, _, part = joint.partition("_")
        name = f"{side}_{_IN_MODELS.get(part, part)}" if side in ("left", "right") else joint
        return joint if name in meant else name

    return tuple(map(modelled, meant))


def found_among(joints: Sequence[str], others: Sequence[str]) -> Int[np.ndarray, " joint"]:
    """Index of each joint among those of another body: by its name, else by what it means; -1 where it is not there.

    What markers are called as one (marker_names) is one: the toe of BlazePose is the big toe of others.
    """
    own = set(joints)
    by_name = {name: index for index, name in enumerate(others)}
    by_meaning = {
        meaning: by_name[name] for name, meaning in zip(others, _as_modelled(others), strict=True) if name not in own
    }
    pairs = zip(joints, _as_modelled(joints), strict=True)
    return np.array([by_name.get(joint, by_meaning.get(meaning, -1)) for joint, meaning in pairs], dtype=int)
