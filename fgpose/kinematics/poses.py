"""Rotation and origin of every segment, for files that hold bodies rather than joints (BVH, C3D)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from fgpose.geometry.up_axis import WorldUp, z_up
from fgpose.kinematics.definitions import BENT_DEG
from fgpose.kinematics.landmarks import Points, landmarks, points_of
from fgpose.kinematics.segments import TRUNK, Rotations, Vectors, bend, pelvis, thorax, unit
from fgpose.trajectory import Trajectory


@dataclass(frozen=True)
class BodySegment:
    """How a segment is found."""

    name: str
    parent: str | None
    start: tuple[str, ...]
    """Its origin is the middle of these landmarks."""
    end: tuple[str, ...]
    axis: tuple[float, float, float] = (0.0, -1.0, 0.0)
    """Its direction from start to end, in its own axes."""
    twist: tuple[str, float] | None = None
    """Landmark at the end of the next segment, which is bent towards this direction of x."""


def _limb(side: str) -> tuple[BodySegment, ...]:
    def at(name: str) -> str:
        return f"{side}_{name}"

    return (
        BodySegment(at("thigh"), "pelvis", (at("hip"),), (at("knee"),), twist=(at("ankle"), -1.0)),
        BodySegment(at("shank"), at("thigh"), (at("knee"),), (at("ankle"),)),
        BodySegment(at("foot"), at("shank"), (at("ankle"),), (at("toe"),), axis=(1.0, 0.0, 0.0)),
        BodySegment(at("upper_arm"), "thorax", (at("shoulder"),), (at("elbow"),), twist=(at("wrist"), 1.0)),
        BodySegment(at("forearm"), at("upper_arm"), (at("elbow"),), (at("wrist"),)),
    )


_SHOULDERS, _HIPS = ("left_shoulder", "right_shoulder"), ("left_hip", "right_hip")
SEGMENTS = (
    BodySegment("pelvis", None, _HIPS, _SHOULDERS, axis=(0.0, 1.0, 0.0)),
    BodySegment("thorax", "pelvis", _HIPS, _SHOULDERS, axis=(0.0, 1.0, 0.0)),
    BodySegment("head", "thorax", _SHOULDERS, ("head",), axis=(0.0, 1.0, 0.0)),
    *_limb("left"),
    *_limb("right"),
)
"""Every parent before its children."""


@dataclass(frozen=True, eq=False)
class SegmentPoses:
    """The segments of a body over time, in a world with z up. NaN where a landmark is missing."""

    segments: tuple[BodySegment, ...]
    """Of SEGMENTS those that the skeleton has, as far as their parents."""
    time_s: Float[np.ndarray, " frame"]
    world_R_segment: Float[np.ndarray, "frame segment 3 3"]
    """Columns are the ISB's x (forward), y (up) and z (right) of the segment."""
    origin_m: Float[np.ndarray, "frame segment 3"]
    end_m: Float[np.ndarray, "frame segment 3"]
    """Where the segment ends."""
    determined: Bool[np.ndarray, "frame segment"]
    """False where joints do not tell the rotation about the segment's own axis, and it was interpolated in time."""

    def subset(self, indices: list[int]) -> SegmentPoses:
        """Some of the segments."""
        names = ("world_R_segment", "origin_m", "end_m", "determined")
        arrays = {name: getattr(self, name)[:, indices] for name in names}
        return replace(self, segments=tuple(self.segments[index] for index in indices), **arrays)

    def parent(self, index: int) -> int | None:
        """Index of the segment that one hangs on."""
        names = [segment.name for segment in self.segments]
        parent = self.segments[index].parent
        return None if parent is None else names.index(parent)


def segment_poses(trajectory: Trajectory, world_up: WorldUp = "z") -> SegmentPoses:
    """The pose of every segment that the trajectory's skeleton has.

    The rotation of thigh and upper arm about their own axis is that of the plane of knee and elbow. Where the limb is
    straighter than 30 degrees it is interpolated between frames where it is not, without any it is as in the parent's
    neutral pose. Shank, forearm, foot and head are turned against the segment before by the shortest rotation.

    Raises:
        ValueError: the skeleton lacks hips or shoulders.
    """
    joints = landmarks(trajectory.skeleton)
    lacking = [name for name in TRUNK if name not in joints]
    if lacking:
        raise ValueError(f"skeleton {trajectory.skeleton.name} lacks {', '.join(lacking)}: it has no segments")
    points = points_of(z_up(trajectory.positions_m, world_up), joints)
    segments = _segments_of(points)
    rotations = {"pelvis": pelvis(points), "thorax": thorax(points)}
    determined = {}
    for segment in segments:
        if segment.parent and segment.name not in rotations:
            swung = _swung(rotations[segment.parent], segment, points)
            twist, known = _twist(swung, segment, points, trajectory.time_s)
            rotations[segment.name] = swung @ twist
            determined[segment.name] = known & determined.get(segment.parent, known)
    everywhere = np.ones(trajectory.n_frames, dtype=bool)
    return SegmentPoses(
        segments,
        trajectory.time_s,
        np.stack([rotations[each.name] for each in segments], axis=1),
        np.stack([_middle(points, each.start) for each in segments], axis=1),
        np.stack([_middle(points, each.end) for each in segments], axis=1),
        np.stack([determined.get(each.name, everywhere) for each in segments], axis=1),
    )


def _segments_of(points: Points) -> tuple[BodySegment, ...]:
    found: dict[str | None, BodySegment] = {}
    for each in SEGMENTS:
        if set(each.start + each.end) <= points.keys() and (each.parent is None or each.parent in found):
            found[each.name] = each
    return tuple(found.values())


def _middle(points: Points, names: tuple[str, ...]) -> Vectors:
    return np.mean([points[name] for name in names], axis=0)


def _swung(world_R_parent: Rotations, segment: BodySegment, points: Points) -> Rotations:
    """The parent's rotation, turned the shortest way so that the segment's axis points to its end."""
    wanted = unit(_middle(points, segment.end) - _middle(points, segment.start))
    present = world_R_parent @ np.array(segment.axis)
    half = unit(wanted + present)
    # Two reflections, at the planes across present and across half, are the rotation by twice the angle between them.
    return _reflection(half) @ _reflection(present) @ world_R_parent


def _reflection(normal: Vectors) -> Rotations:
    return np.eye(3) - 2.0 * normal[..., :, None] * normal[..., None, :]


def _twist(
    swung: Rotations, segment: BodySegment, points: Points, time_s: Float[np.ndarray, " frame"]
) -> tuple[Rotations, Bool[np.ndarray, " frame"]]:
    """Rotation about the segment's own y axis, and where the plane of its limb tells it."""
    n_frames = len(time_s)
    if segment.twist is None or segment.twist[0] not in points:
        known = np.full(n_frames, segment.twist is None)
        return np.broadcast_to(np.eye(3), (n_frames, 3, 3)), known
    end, sign = segment.twist
    bent_to, sine = bend(-swung[..., 1], points[end] - _middle(points, segment.end))
    x = sign * np.einsum("tji,tj->ti", swung, bent_to)
    known = np.nan_to_num(sine) > np.sin(np.deg2rad(BENT_DEG))
    angle = np.zeros(n_frames)
    if known.any():
        angle = np.interp(time_s, time_s[known], np.unwrap(np.arctan2(-x[known, 2], x[known, 0])))
    cos, sin, zero, one = np.cos(angle), np.sin(angle), np.zeros(n_frames), np.ones(n_frames)
    rows = [np.stack(row, axis=-1) for row in ((cos, zero, sin), (zero, one, zero), (-sin, zero, cos))]
    return np.stack(rows, axis=-2), known
