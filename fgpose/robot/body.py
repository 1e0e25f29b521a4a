"""A person as capsules: everything within a radius of the line between two joints.

The radii are those of a large man in light clothes: from about the 95th percentile of the circumferences and lengths
of US Army men (Gordon et al., 2012 Anthropometric Survey of U.S. Army Personnel, NATICK/TR-15/007), as circles, rounded
up. Hands, feet and head reach beyond the joints that a detector knows, in a direction that it does not know: they are
spheres around wrist, ankle, and head or nose.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.live.frame import LivePerson
from fgpose.shown.unknown_names import check_names
from fgpose.skeleton import Skeleton

RADIUS_M: Mapping[str, float] = MappingProxyType(
    {
        "trunk": 0.15,  # half of the depth of the chest; three capsules side by side are as wide as the shoulders
        "neck": 0.08,
        "head": 0.25,  # from the chin to the top, whichever point of the head the joint is
        "upper_arm": 0.07,
        "lower_arm": 0.06,
        "hand": 0.21,  # its length, from the wrist
        "upper_leg": 0.12,
        "lower_leg": 0.08,
        "foot": 0.25,  # from the ankle to the tip of a shoe
    }
)
"""Radius of each part of the body in metres."""
ARM = ("upper_arm", "lower_arm", "hand")
"""The parts that move with the speed of a hand; the others walk."""

_ONE_SIDE = (
    ("upper_arm", "shoulder", "elbow"),
    ("lower_arm", "elbow", "wrist"),
    ("hand", "wrist", "wrist"),
    ("upper_leg", "hip", "knee"),
    ("lower_leg", "knee", "ankle"),
    ("foot", "ankle", "ankle"),
    ("trunk", "shoulder", "hip"),
)
_HEADS = ("head", "nose")


@dataclass(frozen=True, eq=False)
class Body:
    """The capsules of a person with a given skeleton. Each end lies midway between two joints, which may be one."""

    parts: tuple[str, ...]
    """Of each capsule: a key of RADIUS_M."""
    names: tuple[str, ...]
    """Of each capsule, as a person would say it: ``left lower arm``."""
    joints: Int[np.ndarray, "capsule end=2 half=2"]
    """Indices of the joints of each end."""
    radius_m: Float[np.ndarray, " capsule"]

    @staticmethod
    def of(skeleton: Skeleton, radius_m: Mapping[str, float] | None = None) -> Body:
        """The capsules of a skeleton.

        Args:
            skeleton: it must have shoulders, elbows, wrists, hips, knees and ankles, and a head or a nose.
            radius_m: of some parts, instead of RADIUS_M.

        Raises:
            ValueError: the skeleton lacks one of these joints, which is named, or a part is unknown.
        """
        check_names(radius_m or {}, RADIUS_M, "no part of the body is called", "known:")
        radii_m = {**RADIUS_M, **(radius_m or {})}
        parts, names, joints = [], [], []

        def add(part: str, name: str, first: tuple[int, int], second: tuple[int, int]) -> None:
            parts.append(part)
            names.append(name)
            joints.append((first, second))

        for side in ("left", "right"):
            for part, *ends in _ONE_SIDE:
                first, second = (skeleton.index(f"{side}_{end}") for end in ends)
                add(part, f"{side} {part.replace('_', ' ')}", (first, first), (second, second))
        across = {
            what: (skeleton.index(f"left_{what}"), skeleton.index(f"right_{what}")) for what in ("shoulder", "hip")
        }
        add("trunk", "middle of the trunk", across["shoulder"], across["hip"])
        for what, (left, right) in across.items():
            add("trunk", f"{what}s", (left, left), (right, right))
        head = skeleton.index(next((name for name in _HEADS if name in skeleton.joints), _HEADS[0]))
        add("neck", "neck", across["shoulder"], (head, head))
        add("head", "head", (head, head), (head, head))
        return Body(tuple(parts), tuple(names), np.array(joints), np.array([radii_m[part] for part in parts]))

    @cached_property
    def is_sphere(self) -> Bool[np.ndarray, " capsule"]:
        return np.asarray((self.joints[:, 0] == self.joints[:, 1]).all(axis=-1))

    @cached_property
    def _used(self) -> list[int]:
        return np.unique(self.joints).tolist()

    def ends_m(self, positions_m: Float[np.ndarray, "*people joint 3"]) -> Float[np.ndarray, "*people capsule end=2 3"]:
        """Ends of the capsules in the frame of the joints; NaN where a joint of it is."""
        return (positions_m[..., self.joints[..., 0], :] + positions_m[..., self.joints[..., 1], :]) / 2

    def missing(self, person: LivePerson) -> tuple[int, ...]:
        """Joints without which some capsules have no place or no covariance."""
        has_position = np.isfinite(person.positions_m).all(axis=-1)
        known = np.asarray(has_position & np.isfinite(person.covariance_m2).all(axis=(-2, -1)))
        return tuple(joint for joint in self._used if not known[joint])
