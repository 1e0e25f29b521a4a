"""What each joint angle is, as a function of landmarks.

Signs are those of the ISB (Wu et al. 2002, 2005; Grood and Suntay 1983): flexion, adduction, internal rotation and
dorsiflexion are positive. Left limbs are mirrored, so that equal postures of both sides have equal angles.

Not determined by joint centres, and left out: adduction and rotation of the knee; pronation; the tilt of the pelvis,
and with it the flexion of the trunk against the pelvis; inversion of the foot; flexion of the head.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from functools import partial

import numpy as np
from jaxtyping import Bool, Float

from fgpose.kinematics.landmarks import Points
from fgpose.kinematics.segments import (
    MIRROR,
    TRUNK,
    UP,
    Rotations,
    Vectors,
    away_from,
    bend,
    heading,
    in_frame,
    pelvis,
    thorax,
    unit,
)

Angle = tuple[Float[np.ndarray, "*frames"], Bool[np.ndarray, "*frames"] | bool]
"""Radians, and where the angle is determined (apart from missing landmarks)."""

# A knee or elbow centre that is 10 mm beside the plane of its limb turns that plane by 3 degrees at a bend of 30 (of a
# segment of 0.4 m), by 9 at 10, and real knees have some degrees of valgus, which act in the same way.
BENT_DEG = 30.0
"""Knee or elbow flexion from which the plane of the limb tells how thigh or upper arm are rotated."""
# Of an angle about an axis: for the same 10 mm it errs by 8 degrees there.
_OFF_AXIS_DEG = 10.0
_SIDES = ("left", "right")


def angles_of(points: Points, of: Collection[str] | None = None) -> dict[str, Angle]:
    """Every angle that these landmarks determine, by name: trunk first, then limb by limb, left before right.

    Args:
        points: of one or many frames, in a world with z up.
        of: names of landmarks; angles that depend on none of them may be left out.
    """
    found: dict[str, Angle] = {}
    for needed, helpful, family in _FAMILIES:
        if points.keys() >= set(needed) and (of is None or not set(of).isdisjoint(needed + helpful)):
            found |= dict(family(points))
    return found


def _between(a: Vectors, b: Vectors) -> Float[np.ndarray, "*frames"]:
    """Angle between vectors of length 1, exact near 0 and 180 degrees too."""
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.sum(a * b, axis=-1))


def _side(value: Vectors, side: str) -> Vectors:
    return value * MIRROR if side == "left" else value


def _segment(points: Points, start: str, end: str, side: str) -> Vectors | None:
    """Direction from one landmark of a side to another; None if the skeleton lacks one."""
    names = f"{side}_{start}", f"{side}_{end}"
    return unit(points[names[1]] - points[names[0]]) if points.keys() >= set(names) else None


def _knee_and_ankle(points: Points, side: str) -> Iterator[tuple[str, Angle]]:
    thigh, shank = _segment(points, "hip", "knee", side), _segment(points, "knee", "ankle", side)
    foot = _segment(points, "heel", "toe", side)
    if thigh is not None and shank is not None:
        yield f"{side}_knee_flexion", (_between(thigh, shank), True)
    if shank is not None and foot is not None:
        # The foot is at right angles to the shank in neutral position.
        yield f"{side}_ankle_dorsiflexion", (np.pi / 2 - _between(-shank, foot), True)


def _elbow(points: Points, side: str) -> Iterator[tuple[str, Angle]]:
    upper_arm, forearm = _segment(points, "shoulder", "elbow", side), _segment(points, "elbow", "wrist", side)
    if upper_arm is not None and forearm is not None:
        yield f"{side}_elbow_flexion", (_between(upper_arm, forearm), True)


def _hip(points: Points, side: str) -> Iterator[tuple[str, Angle]]:
    """Z-X-Y of the femur in the pelvis (Wu 2002); its x axis is opposite to where the shank is bent to."""
    thigh, shank = _segment(points, "hip", "knee", side), _segment(points, "knee", "ankle", side)
    if thigh is not None:
        for name, angle in _zxy(pelvis(points), thigh, shank, -1.0, side):
            yield f"{side}_hip_{name}", angle


def arms_in_zxy(points: Points) -> dict[str, Angle]:
    """Flexion, adduction and rotation of the arms (left_arm_flexion) as OpenSim has them: Z-X-Y of the humerus in the
    thorax."""
    found = {}
    for side in _SIDES:
        upper_arm, forearm = _segment(points, "shoulder", "elbow", side), _segment(points, "elbow", "wrist", side)
        if upper_arm is not None and points.keys() >= set(TRUNK):
            angles = _zxy(thorax(points), upper_arm, forearm, 1.0, side)
            found |= {f"{side}_arm_{name}": angle for name, angle in angles}
    return found


def _zxy(
    world_R_parent: Rotations, proximal: Vectors, distal: Vectors | None, forward: float, side: str
) -> Iterator[tuple[str, Angle]]:
    """Flexion, adduction and, where the limb is bent enough, rotation.

    Args:
        world_R_parent: pelvis or thorax.
        proximal: direction of thigh or upper arm.
        distal: of shank or forearm.
        forward: sign of x where the distal segment is bent to.
        side: of the limb.
    """
    y = _side(in_frame(world_R_parent, -proximal), side)
    flexion, adduction = np.arctan2(-y[..., 0], y[..., 1]), np.arcsin(np.clip(y[..., 2], -1.0, 1.0))
    in_plane = away_from(np.array([0.0, 0.0, 1.0]), y, _OFF_AXIS_DEG)
    yield "flexion", (flexion, in_plane)
    yield "adduction", (adduction, True)
    if distal is None:
        return
    bent_to, sine = bend(proximal, distal)
    x = forward * _side(in_frame(world_R_parent, bent_to), side)
    # What x would be without rotation, and what is a quarter turn from there.
    unrotated = np.stack([np.cos(flexion), np.sin(flexion), np.zeros_like(flexion)], axis=-1)
    quarter = np.cross(y, unrotated)
    rotation = np.arctan2(np.sum(x * quarter, axis=-1), np.sum(x * unrotated, axis=-1))
    yield "rotation", (rotation, in_plane & _bent(sine))


def _shoulder(points: Points, side: str) -> Iterator[tuple[str, Angle]]:
    """Y-X-Y of the humerus in the thorax (Wu 2005); its x axis is where the forearm is bent to (their option 2).

    Elevation counts positive. In plane 0 it is abduction, in plane 90 degrees forward flexion.
    """
    upper_arm, forearm = _segment(points, "shoulder", "elbow", side), _segment(points, "elbow", "wrist", side)
    if upper_arm is None:
        return
    world_R_thorax = thorax(points)
    y = _side(in_frame(world_R_thorax, -upper_arm), side)
    raised = away_from(np.array([0.0, 1.0, 0.0]), y, _OFF_AXIS_DEG)
    plane = np.arctan2(-y[..., 0], -y[..., 2])
    elevation = np.arctan2(np.hypot(y[..., 0], y[..., 2]), y[..., 1])
    yield f"{side}_shoulder_elevation", (elevation, True)
    yield f"{side}_shoulder_elevation_plane", (plane, raised)
    if forearm is None:
        return
    bent_to, sine = bend(upper_arm, forearm)
    x = _side(in_frame(world_R_thorax, bent_to), side)
    unrotated = np.stack([np.cos(plane), np.zeros_like(plane), -np.sin(plane)], axis=-1)
    rotation = np.arctan2(np.sum(x * np.cross(y, unrotated), axis=-1), np.sum(x * unrotated, axis=-1))
    yield f"{side}_shoulder_rotation", (rotation, raised & _bent(sine))


def _bent(sine: Float[np.ndarray, "*frames"]) -> Bool[np.ndarray, "*frames"]:
    with np.errstate(invalid="ignore"):
        return sine > np.sin(np.deg2rad(BENT_DEG))


def _trunk(points: Points) -> Iterator[tuple[str, Angle]]:
    """Thorax against the vertical and against the pelvis, pelvis against the horizontal, head against the thorax."""
    world_R_pelvis, world_R_thorax = pelvis(points), thorax(points)
    right, pelvis_right = world_R_thorax[..., 2], world_R_pelvis[..., 2]
    axis = in_frame(heading(right), world_R_thorax[..., 1])
    level = away_from(UP, right, _OFF_AXIS_DEG)
    upright = away_from(np.array([0.0, 0.0, 1.0]), axis, _OFF_AXIS_DEG)
    yield "trunk_flexion", (np.arctan2(axis[..., 0], axis[..., 1]), level & upright)
    yield "trunk_lateral_bending", (np.arcsin(np.clip(axis[..., 2], -1.0, 1.0)), level)
    forward = heading(right)[..., 0]
    yield "trunk_heading", (np.arctan2(forward[..., 1], forward[..., 0]), level)
    yield "pelvis_obliquity", (np.arcsin(np.clip(-pelvis_right[..., 2], -1.0, 1.0)), True)
    in_pelvis = in_frame(world_R_pelvis, world_R_thorax[..., 1])
    bending = np.arctan2(in_pelvis[..., 2], in_pelvis[..., 1])
    yield "spine_lateral_bending", (bending, True)
    # Thorax = pelvis Rx(bending) Ry(rotation).
    x = in_frame(world_R_pelvis, world_R_thorax[..., 0])
    z = in_frame(world_R_pelvis, right)
    yield "spine_rotation", (np.arctan2(z[..., 0], x[..., 0]), True)
    if points.keys() >= {"left_ear", "right_ear"}:
        # Y-X-Z, not Z-X-Y: the line of the ears tells these two, whatever the flexion.
        ears = in_frame(world_R_thorax, unit(points["right_ear"] - points["left_ear"]))
        turned = away_from(np.array([0.0, 1.0, 0.0]), ears, _OFF_AXIS_DEG)
        yield "head_rotation", (np.arctan2(ears[..., 0], ears[..., 2]), turned)
        yield "head_lateral_bending", (np.arcsin(np.clip(-ears[..., 1], -1.0, 1.0)), True)


def _families_of(*sides: str) -> Iterator[_Family]:
    for side in sides:
        hip, knee, ankle, foot = f"{side}_hip", f"{side}_knee", f"{side}_ankle", (f"{side}_heel", f"{side}_toe")
        yield (*TRUNK, knee), (ankle,), partial(_hip, side=side)
        yield (knee, ankle), (hip, *foot), partial(_knee_and_ankle, side=side)
    for side in sides:
        shoulder, elbow, wrist = f"{side}_shoulder", f"{side}_elbow", f"{side}_wrist"
        yield (*TRUNK, elbow), (wrist,), partial(_shoulder, side=side)
        yield (shoulder, elbow, wrist), (), partial(_elbow, side=side)


_Family = tuple[tuple[str, ...], tuple[str, ...], Callable[[Points], Iterator[tuple[str, Angle]]]]
# Landmarks that a family of angles needs, those with which it has more angles, and its angles.
_FAMILIES: tuple[_Family, ...] = ((TRUNK, ("left_ear", "right_ear"), _trunk), *_families_of("left", "right"))
