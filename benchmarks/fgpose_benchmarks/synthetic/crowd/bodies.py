"""Bodies and furniture that hide joints from cameras: capsules around bones, and boxes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.geometry.segments import nearest_on_segments
from fgpose.skeleton import Skeleton

VISIBLE = -1
"""In place of the number of the person who hides a joint: nobody does."""
FURNITURE = -2
"""In place of the number of the person who hides a joint: furniture does."""

# Ends and radius in metres of an adult man in clothes: half of the depth of the chest and of the breadths of limbs and
# head (about the 50th percentiles of NASA-STD-3000). Two capsules side by side make the trunk wider than deep.
_CAPSULES_M = (
    ("left_hip", "left_shoulder", 0.10),
    ("right_hip", "right_shoulder", 0.10),
    ("pelvis", "thorax", 0.12),
    ("thorax", "neck_base", 0.07),
    ("neck_base", "head", 0.095),
    *((f"{side}_{a}", f"{side}_{b}", radius_m)
      for side in ("left", "right")
      for a, b, radius_m in (
          ("hip", "knee", 0.08),
          ("knee", "ankle", 0.055),
          ("shoulder", "elbow", 0.05),
          ("elbow", "wrist", 0.04),
      )),
)  # fmt: skip
_N_TRUNK = 3  # the first capsules
_FLESH_M = 0.03  # a joint that lies within this of a capsule of its own body belongs to it, as a hip to the trunk
_PAIRS_AT_ONCE = 4000  # bounds the memory: 4000 x 17 joints x 13 capsules x 3 coordinates are 20 MB


@dataclass(frozen=True)
class Furniture:
    """Furniture: a box along the axes of the world.

    Raises:
        ValueError: a number is not finite, or a lower corner is not below the upper one.
    """

    low_m: tuple[float, float, float]
    high_m: tuple[float, float, float]

    def __post_init__(self) -> None:
        if not np.isfinite([self.low_m, self.high_m]).all() or (np.array(self.low_m) >= self.high_m).any():
            raise ValueError(f"a box needs its lower corner below its upper one, got {self.low_m} and {self.high_m}")


@dataclass(frozen=True, eq=False)
class Capsules:
    """The capsules of a body: everything within a radius of the segment between two joints."""

    ends: Int[np.ndarray, "capsule 2"]
    radius_m: Float[np.ndarray, " capsule"]
    covers: Bool[np.ndarray, "joint capsule"]
    """Whether the capsule is flesh in which the joint lies, as the sides of the trunk around the spine."""

    @staticmethod
    def of(skeleton: Skeleton) -> Capsules:
        """An adult's. Raises ValueError if the skeleton lacks a joint of them."""
        ends = np.array([[skeleton.index(a), skeleton.index(b)] for a, b, _ in _CAPSULES_M])
        midline = skeleton.mirror == np.arange(skeleton.n_joints)
        trunk = np.arange(len(ends)) < _N_TRUNK
        return Capsules(ends, np.array([radius_m for *_, radius_m in _CAPSULES_M]), midline[:, None] & trunk)


def hidden_by(
    position_m: Float[np.ndarray, " 3"],
    people_m: Float[np.ndarray, "frame person joint 3"],
    capsules: Capsules,
    furniture: Sequence[Furniture] = (),
    *,
    own_body: bool = False,
) -> Int[np.ndarray, "frame person joint"]:
    """Who hides each joint from a camera at a position (world frame, metres): a person's number, FURNITURE or VISIBLE.

    A joint is hidden if the segment from the camera to it meets furniture or a capsule of another person. Of several
    people who hide it, the one nearest to the camera counts; people count before furniture. Joints that are NaN are
    VISIBLE.

    Args:
        own_body: whether people hide joints of their own too, by the capsules that the joint does not belong to.
    """
    hider = np.where(_behind_boxes(position_m, people_m, furniture), FURNITURE, VISIBLE)
    frame, person, other = _candidates(position_m, people_m, capsules, own_body)
    distance_m = np.linalg.norm(people_m[:, :, 0] - position_m, axis=-1)
    # The farthest first: nearer ones overwrite them.
    order = np.argsort(-distance_m[frame, other], kind="stable")
    frame, person, other = frame[order], person[order], other[order]
    hidden = np.zeros((len(frame), people_m.shape[2]), dtype=bool)
    for first in range(0, len(frame), _PAIRS_AT_ONCE):
        part = slice(first, first + _PAIRS_AT_ONCE)
        joints_m, body_m = people_m[frame[part], person[part]], people_m[frame[part], other[part]]
        is_own = person[part] == other[part]
        hidden[part] = _behind_capsules(position_m, joints_m, body_m, capsules, is_own)
    pair, joint = np.nonzero(hidden)
    hider[frame[pair], person[pair], joint] = other[pair]
    return hider


def _candidates(
    position_m: Float[np.ndarray, " 3"],
    people_m: Float[np.ndarray, "frame person joint 3"],
    capsules: Capsules,
    own_body: bool,
) -> tuple[Int[np.ndarray, " pair"], Int[np.ndarray, " pair"], Int[np.ndarray, " pair"]]:
    """Frame, person and other of all who can be hidden by the other: from the camera, the cones around both overlap,
    and the other begins before the person ends."""
    there = np.asarray(np.isfinite(people_m).all(axis=(2, 3)))
    known_m = np.where(there[..., None, None], people_m, 0.0)
    centre_m = known_m.mean(axis=2)
    radius_m = np.linalg.norm(known_m - centre_m[:, :, None], axis=-1).max(axis=2) + capsules.radius_m.max()
    ray_m = centre_m - position_m
    distance_m = np.linalg.norm(ray_m, axis=-1)
    direction = ray_m / np.maximum(distance_m, 1e-9)[..., None]
    half_angle = np.arcsin(np.minimum(radius_m / np.maximum(distance_m, 1e-9), 1.0))
    angle = np.arccos(np.clip(np.einsum("fpi,fqi->fpq", direction, direction), -1.0, 1.0))
    overlap = angle <= half_angle[:, :, None] + half_angle[:, None]
    overlap &= (distance_m - radius_m)[:, None] <= (distance_m + radius_m)[:, :, None]
    overlap &= there[:, :, None] & there[:, None]
    if not own_body:
        overlap &= ~np.eye(people_m.shape[1], dtype=bool)
    frame, person, other = np.nonzero(overlap)
    return frame, person, other


def _behind_capsules(
    position_m: Float[np.ndarray, " 3"],
    joints_m: Float[np.ndarray, "pair joint 3"],
    body_m: Float[np.ndarray, "pair joint 3"],
    capsules: Capsules,
    is_own: Bool[np.ndarray, " pair"],
) -> Bool[np.ndarray, "pair joint"]:
    start_m, end_m = (body_m[:, None, capsules.ends[:, end]] for end in (0, 1))
    joints_m = joints_m[:, :, None]
    hit = nearest_on_segments(position_m, joints_m, start_m, end_m)[-1] < capsules.radius_m
    if is_own.any():
        *_, at_joint_m = nearest_on_segments(joints_m[is_own], joints_m[is_own], start_m[is_own], end_m[is_own])
        hit[is_own] &= (at_joint_m > capsules.radius_m + _FLESH_M) & ~capsules.covers
    return np.asarray(hit.any(axis=-1))


def _behind_boxes(
    position_m: Float[np.ndarray, " 3"], points_m: Float[np.ndarray, "*points 3"], boxes: Sequence[Furniture]
) -> Bool[np.ndarray, "*points"]:
    """Whether the segment from a position to each point meets a box: the slab method."""
    behind = np.zeros(points_m.shape[:-1], dtype=bool)
    ray_m = points_m - position_m
    ray_m = np.where(np.abs(ray_m) < 1e-12, 1e-12, ray_m)
    for box in boxes:
        enter, leave = ((np.array(corner_m) - position_m) / ray_m for corner_m in (box.low_m, box.high_m))
        first = np.minimum(enter, leave).max(axis=-1)
        last = np.maximum(enter, leave).min(axis=-1)
        behind |= (first <= last) & (last >= 0.0) & (first <= 1.0)
    return behind
