"""What is known of every body: where head, legs and feet are among the joints, and their sizes as shares of stature."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from fgpose.kinematics.proportions import ANKLE_HEIGHT, SHANK, THIGH, TRUNK
from fgpose.skeleton import Skeleton
from fgpose_factors.robust_statistics import known_median

_LEG = THIGH + SHANK
# Median scale errors of HumanCalib (docs/METHOD.md, five data sets): 1.9 % with the legs, 2 to 3 % with legs and trunk.
# A median error is 0.674 standard deviations.
_LEG_SIGMA, _LEG_AND_TRUNK_SIGMA = 0.028, 0.037
# Networks for images place the hips some 85 mm in front of the centres of the joints, which makes thighs longer and
# the trunk shorter by as much (HumanCalib, scale_scene.py): only the sum is right.
_JOINT_CENTRES = ("h36m", "smpl")
# Of the ankle above the floor: lateral malleolus, and a sole of 20 mm. Feet with and without shoes differ by as much as
# the second number.
_ANKLE, _ANKLE_SIGMA = ANKLE_HEIGHT + 0.012, 0.008
# Detectors mark heels and toes on the shoe, one or two centimetres above its sole.
_SOLE, _SOLE_SIGMA = 0.010, 0.006


class Head(NamedTuple):
    """A point of the head and how high it is, as a share of the stature: 95th centile of a walk above the floor."""

    joints: tuple[str, ...]
    """It is their mean."""
    height: float
    sigma: float
    """Between people."""


# The band around the head is at 0.9255, with a median error of 1.0 % (five data sets, HumanCalib docs/METHOD.md); the
# ears are at its height within the error. Walking lowers the top of the head to 0.97 (motion capture of CMU's subject
# 02); the noise of detections raises a 95th centile by 1 to 2 %. Eyes and nose are lower than of somebody who stands
# if the walker looks at the floor.
_HEADS = (
    Head(("left_ear", "right_ear"), 0.9255, 0.015),
    Head(("head_top",), 0.985, 0.02),
    Head(("head",), 0.985, 0.02),
    Head(("left_eye", "right_eye"), 0.92, 0.025),
    Head(("nose",), 0.90, 0.03),
)
# Upper ends of the axis of the body where there is no head, the highest first.
_TOPS = (("neck_base",), ("neck",), ("thorax",), ("left_shoulder", "right_shoulder"))
_SOLES = ("heel", "big_toe", "small_toe", "foot_index")


@dataclass(frozen=True)
class Anatomy:
    """The joints that tell size and posture. Raises ValueError if the skeleton lacks hips, knees or ankles."""

    skeleton: Skeleton

    def __post_init__(self) -> None:
        for joint in ("hip", "knee", "ankle"):
            self._pair(joint)

    def _pair(self, joint: str) -> tuple[int, int]:
        return self.skeleton.index(f"left_{joint}"), self.skeleton.index(f"right_{joint}")

    @property
    def head(self) -> Head | None:
        """None where the skeleton has no joint of the head whose height is known."""
        # The head of SMPL is the joint on the spine.
        heads = () if self.skeleton.name.startswith("smpl") else _HEADS
        return next((head for head in heads if self._has(head.joints)), None)

    @property
    def segments(self) -> tuple[float, float]:
        """What segments_m is of the stature, and its standard deviation between people."""
        return (_LEG, _LEG_SIGMA) if self._legs_alone else (_LEG + TRUNK, _LEG_AND_TRUNK_SIGMA)

    @property
    def foot_height(self) -> tuple[float, float]:
        """How high foot_m is above the floor while it stands there, as a share of the stature, and its sigma."""
        return (_SOLE, _SOLE_SIGMA) if self._sole(0) else (_ANKLE, _ANKLE_SIGMA)

    @property
    def _legs_alone(self) -> bool:
        return self.skeleton.name.startswith(_JOINT_CENTRES) or not self._has(("left_shoulder", "right_shoulder"))

    def _has(self, joints: tuple[str, ...]) -> bool:
        return set(joints) <= set(self.skeleton.joints)

    def _sole(self, side: int) -> list[int]:
        names = (f"{('left', 'right')[side]}_{part}" for part in _SOLES)
        return [self.skeleton.index(name) for name in names if name in self.skeleton.joints]

    def mean_m(
        self, joints_m: Float[np.ndarray, "frame joint 3"], joints: tuple[str, ...]
    ) -> Float[np.ndarray, "frame 3"]:
        """Middle of the named joints; NaN where one of them is missing."""
        return np.mean([joints_m[:, self.skeleton.index(joint)] for joint in joints], axis=0)

    def top_m(self, joints_m: Float[np.ndarray, "frame joint 3"]) -> Float[np.ndarray, "frame 3"]:
        """Upper end of the axis of the body."""
        tops = (*(head.joints for head in _HEADS), *_TOPS)
        return self.mean_m(joints_m, next((top for top in tops if self._has(top)), ("left_hip", "right_hip")))

    def hips_m(self, joints_m: Float[np.ndarray, "frame joint 3"]) -> Float[np.ndarray, "frame 3"]:
        return self.mean_m(joints_m, ("left_hip", "right_hip"))

    def bottom_m(self, joints_m: Float[np.ndarray, "frame joint 3"]) -> Float[np.ndarray, "frame 3"]:
        """Lower end of the axis: the middle of the ankles."""
        return self.mean_m(joints_m, ("left_ankle", "right_ankle"))

    def feet_m(self, joints_m: Float[np.ndarray, "frame joint 3"]) -> Float[np.ndarray, "frame foot part 3"]:
        """The points of both feet that come nearest to the floor: heels and toes, or the ankles."""
        parts = [self._sole(side) or [self._pair("ankle")[side]] for side in (0, 1)]
        return joints_m[:, np.array(parts)]

    def left(self, joints_m: Float[np.ndarray, "frame joint 3"]) -> Float[np.ndarray, "frame 3"]:
        """Unit vectors from the right side of the body to the left one, from hips and shoulders."""
        pairs = [pair for pair in ("hip", "shoulder") if self._has((f"left_{pair}", f"right_{pair}"))]
        across_m = np.mean([np.diff(joints_m[:, self._pair(pair)[::-1]], axis=1)[:, 0] for pair in pairs], axis=0)
        length_m = np.linalg.norm(across_m, axis=-1, keepdims=True)
        return across_m / np.where(length_m > 0, length_m, np.nan)

    def segments_m(self, joints_m: Float[np.ndarray, "frame joint 3"]) -> float:
        """Length of a thigh and a shank, and of the trunk where a network for images found the joints: medians over
        the frames. NaN where one of them was never seen."""
        sides = [[self._pair(joint)[side] for joint in ("hip", "knee", "ankle")] for side in (0, 1)]
        bones = [(a, b) for chain in sides for a, b in pairwise(chain)]
        length_m = [known_median(np.linalg.norm(joints_m[:, a] - joints_m[:, b], axis=-1)) for a, b in bones]
        total_m = sum(length_m) / 2
        if self._legs_alone:
            return total_m
        shoulders_m = self.mean_m(joints_m, ("left_shoulder", "right_shoulder"))
        return total_m + known_median(np.linalg.norm(shoulders_m - self.hips_m(joints_m), axis=-1))

    def stature_m(self, joints_m: Float[np.ndarray, "frame joint 3"]) -> float:
        """As the segments tell it, in the unit of the joints."""
        return self.segments_m(joints_m) / self.segments[0]
