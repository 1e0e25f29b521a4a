"""Frames of the segments of a body, with the axes of the ISB: x forward, y up, z to the right.

Wu et al. 2002 (pelvis, femur) and 2005 (thorax, humerus) define them by bony landmarks. Here joint centres take their
place, which leaves less determined: two hip centres do not tell how the pelvis is tilted, so its y axis is that of the
trunk; and thigh and upper arm have a rotation about their own axis only where knee or elbow are bent.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from fgpose.kinematics.landmarks import Points

Vectors = Float[np.ndarray, "*frames 3"]
Rotations = Float[np.ndarray, "*frames 3 3"]

UP = np.array([0.0, 0.0, 1.0])
"""Of the world in which segments are computed."""
MIRROR = np.array([1.0, 1.0, -1.0])
"""Turns what is said of a left limb, in the axes of a segment of the midline, into what is said of a right one."""
TRUNK = ("left_hip", "right_hip", "left_shoulder", "right_shoulder")
"""Landmarks that pelvis and thorax need."""


def unit(vectors: Vectors) -> Vectors:
    """Of length 1; NaN where a vector has none."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.divide(vectors, length, out=np.full(vectors.shape, np.nan), where=length > 0)


def across(vectors: Vectors, axis: Float[np.ndarray, "*#frames 3"]) -> Vectors:
    """The part of vectors that is perpendicular to an axis of length 1."""
    return vectors - np.sum(vectors * axis, axis=-1, keepdims=True) * axis


def frame_of(y: Vectors, z: Vectors) -> Rotations:
    """World from segment; columns are x, y and z. Both axes have length 1 and are perpendicular."""
    return np.stack([np.cross(y, z), y, z], axis=-1)


def in_frame(world_R_segment: Rotations, vectors: Vectors) -> Vectors:
    """Vectors of the world in the axes of a segment."""
    return np.einsum("...ji,...j->...i", world_R_segment, vectors)


def trunk_axis(points: Points) -> Vectors:
    """From the middle of the hips to the middle of the shoulders, metres."""
    return (points["left_shoulder"] + points["right_shoulder"] - points["left_hip"] - points["right_hip"]) / 2


def pelvis(points: Points) -> Rotations:
    """World from pelvis: z from the left hip to the right one, y as near to the trunk as it can be."""
    z = unit(points["right_hip"] - points["left_hip"])
    return frame_of(unit(across(trunk_axis(points), z)), z)


def thorax(points: Points) -> Rotations:
    """World from thorax: y along the trunk, z as near to the line from the left to the right shoulder as it can be."""
    y = unit(trunk_axis(points))
    return frame_of(y, unit(across(points["right_shoulder"] - points["left_shoulder"], y)))


def heading(right: Vectors) -> Rotations:
    """World from a frame that stands upright: y is up, z as near to the right of a segment as it can be."""
    z = unit(across(right, UP))
    return frame_of(np.broadcast_to(UP, z.shape), z)


def bend(long_axis: Vectors, distal: Vectors) -> tuple[Vectors, Float[np.ndarray, "*frames"]]:
    """How the distal segment of a limb leaves the long axis of the proximal one.

    Args:
        long_axis: of the proximal segment, length 1.
        distal: of the distal segment, any length.

    Returns:
        The direction across the long axis, and the sine of the angle between the segments.
    """
    off = across(unit(distal), long_axis)
    return unit(off), np.linalg.norm(off, axis=-1)


def away_from(axis: Float[np.ndarray, "*#frames 3"], vectors: Vectors, least_deg: float) -> Bool[np.ndarray, "*frames"]:
    """Whether vectors are at least so far from being parallel to an axis. Both have length 1."""
    with np.errstate(invalid="ignore"):
        return np.linalg.norm(np.cross(axis, vectors), axis=-1) > np.sin(np.deg2rad(least_deg))
