"""Sitting: seats, and the poses of a person who walks or stands, bent so that the person sits.

Nobody sits in the clips of motion capture that come with fgpose. So hips and knees are bent about the left-right axis
of the body, by about 90 degrees; the feet stay on the floor, and trunk, head and arms are those of the clip. Only
directions of bones change: their lengths stay what they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from fgpose.skeleton import Skeleton
from fgpose_benchmarks.synthetic.body_motion import ANKLE_M, Poses, above_legs, leg_length_m
from fgpose_benchmarks.synthetic.crowd.bodies import Furniture

_DEPTH_M = 0.4  # of a seat, and from the ankles of somebody who sits to its middle: about the length of a thigh
_FLESH_M = 0.08  # of a thigh, between the hip joint and the seat: as its capsule in bodies.py
_LEAN_RAD = 0.45  # of trunk and arms, half-way between standing and sitting: weight has to be over the feet
_MAX_TILT = 0.7  # sine of the angle between a thigh and the floor


@dataclass(frozen=True)
class Seat:
    """A stool, on which one person at a time may sit."""

    feet_m: tuple[float, float]
    """Where somebody stands before sitting down, and where the feet stay: world frame, metres."""
    facing_rad: float
    """Heading of whoever sits: 0 along x."""
    height_m: float = 0.44

    @property
    def middle_m(self) -> Float[np.ndarray, " 2"]:
        facing = np.array([np.cos(self.facing_rad), np.sin(self.facing_rad)])
        return np.array(self.feet_m) - _DEPTH_M * facing

    @property
    def hips_m(self) -> float:
        """Height of the hip joints of whoever sits."""
        return self.height_m + _FLESH_M

    @property
    def box(self) -> Furniture:
        """What hides joints: as deep as it is wide."""
        (x_m, y_m), half_m = self.middle_m.tolist(), _DEPTH_M / 2
        return Furniture((x_m - half_m, y_m - half_m, 0.0), (x_m + half_m, y_m + half_m, self.height_m))


def seated(
    poses: Poses,
    share: Float[np.ndarray, " frame"],
    hips_m: float,
    bone_lengths_m: Float[np.ndarray, " bone"],
    skeleton: Skeleton,
) -> Poses:
    """On the way from poses of somebody who stands (share 0) to sitting (1).

    Who sits has level hips, vertical shanks, and both ankles below the origin, at the height of somebody who stands. On
    the way directions are interpolated, the middle of the ankles moves straight, and the trunk leans forward.

    Args:
        hips_m: height of the hip joints while sitting, metres.

    Raises:
        ValueError: legs of this length do not sit at this height.
    """
    legs = {side: _leg_bones(side, skeleton) for side in ("left", "right")}
    _, thigh_m, shank_m = bone_lengths_m[legs["left"]]
    tilt = (hips_m - ANKLE_M - shank_m) / thigh_m
    if abs(tilt) > _MAX_TILT:
        raise ValueError(f"hips at {hips_m:.2f} m are too high or too low for thighs of {thigh_m:.2f} m and shanks of "
                         f"{shank_m:.2f} m")  # fmt: skip
    bent = poses.direction.copy()
    for side, leftwards in (("left", 1.0), ("right", -1.0)):
        bent[:, legs[side]] = (0, leftwards, 0), (np.sqrt(1 - tilt**2), 0, -tilt), (0, 0, -1)
    lean = 4 * share * (1 - share) * _LEAN_RAD
    moved = poses.blend(Poses(bent, poses.root), share)
    moved = moved.leaning(lean[:, None, None] * above_legs(skeleton) * np.array([1.0, 0.0, 0.0]))

    def ankles_m(of: Poses) -> Float[np.ndarray, "frame 3"]:
        """The middle of both, from the pelvis."""
        return np.mean([bone_lengths_m[leg] @ of.direction[:, leg] for leg in legs.values()], axis=0)

    leg_m = leg_length_m(bone_lengths_m, skeleton)
    standing_m = leg_m * poses.root + ankles_m(poses)
    on_floor_m = standing_m + share[:, None] * (np.array([0.0, 0.0, ANKLE_M]) - standing_m)
    return Poses(moved.direction, (on_floor_m - ankles_m(moved)) / leg_m)


def _leg_bones(side: str, skeleton: Skeleton) -> list[int]:
    """From the pelvis to the ankle."""
    chain = ["pelvis", *(f"{side}_{joint}" for joint in ("hip", "knee", "ankle"))]
    return [skeleton.bones.index((skeleton.index(a), skeleton.index(b))) for a, b in pairwise(chain)]
