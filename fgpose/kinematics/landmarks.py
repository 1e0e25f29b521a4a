"""Points of the body that segments are made of, whatever the skeleton calls them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from fgpose.shown.joint_meanings import meanings
from fgpose.skeleton import Skeleton

Points = Mapping[str, Float[np.ndarray, "*frames 3"]]
"""Positions in the world frame, metres, by the name of the landmark: left_hip, right_toe."""

# Each landmark is the mean of the joints of the first line that the skeleton has.
_OF_A_SIDE = {
    **{name: ((name,),) for name in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist", "heel", "ear")},
    "toe": (("big_toe", "small_toe"), ("big_toe",), ("foot_index",), ("foot",)),
}
_OF_THE_MIDLINE = {"head": (("head",), ("head_top",), ("left_ear", "right_ear"), ("nose",))}


def landmarks(skeleton: Skeleton) -> dict[str, tuple[int, ...]]:
    """The joints whose mean each landmark is, of the landmarks that a skeleton has, whatever it calls them (meanings).

    They are hip, knee, ankle, shoulder, elbow, wrist, heel, ear and toe of both sides (left_hip), and head.
    """
    wanted: dict[str, tuple[tuple[str, ...], ...]] = dict(_OF_THE_MIDLINE)
    for side in ("left", "right"):
        for name, choices in _OF_A_SIDE.items():
            wanted[f"{side}_{name}"] = tuple(tuple(f"{side}_{joint}" for joint in joints) for joints in choices)
    found, own = {}, meanings(skeleton.joints)
    for name, choices in wanted.items():
        joints = next((joints for joints in choices if set(joints) <= set(own)), None)
        if joints:
            found[name] = tuple(own.index(joint) for joint in joints)
    return found


def points_of(
    positions_m: Float[np.ndarray, "*frames joint 3"], joints: Mapping[str, tuple[int, ...]]
) -> dict[str, Float[np.ndarray, "*frames 3"]]:
    """Positions of landmarks; NaN where one of their joints is."""
    return {name: positions_m[..., list(indices), :].mean(axis=-2) for name, indices in joints.items()}
