"""A body built from its joint angles by scipy's rotations, which know nothing of how fgpose finds angles."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from fgpose.io.skeletons import load_skeleton
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Status, Trajectory

BODY = load_skeleton("body_25")
_MIRROR = np.diag([1.0, 1.0, -1.0])
# World with z up and x forward from the ISB's axes (y up, z to the right).
_WORLD_R_ISB = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def random_angles(rng: np.random.Generator) -> dict[str, float]:
    """A posture in which every angle is determined, within what people can do."""
    ranges = {
        "trunk_heading": (-179, 179),
        "trunk_flexion": (-30, 60),
        "trunk_lateral_bending": (-30, 30),
        "spine_lateral_bending": (-30, 30),
        "spine_rotation": (-40, 40),
        "head_rotation": (-70, 70),
        "head_lateral_bending": (-30, 30),
    }
    of_a_side = {
        "hip_flexion": (-20, 100),
        "hip_adduction": (-40, 20),
        "hip_rotation": (-35, 35),
        "knee_flexion": (32, 130),
        "ankle_dorsiflexion": (-40, 20),
        "shoulder_elevation_plane": (-80, 130),
        "shoulder_elevation": (15, 150),
        "shoulder_rotation": (-80, 80),
        "elbow_flexion": (32, 140),
    }
    ranges |= {f"{side}_{name}": limits for side in ("left", "right") for name, limits in of_a_side.items()}
    return {name: float(rng.uniform(*limits)) for name, limits in ranges.items()}


def built(angles_deg: Mapping[str, float], skeleton: Skeleton = BODY) -> np.ndarray:
    """Positions of the joints, (J, 3), in a world with z up; angles that are not named are zero."""

    def turned(axes: str, *names: str) -> np.ndarray:
        return Rotation.from_euler(axes, [angles_deg.get(name, 0.0) for name in names], degrees=True).as_matrix()

    # Flexion forward is a negative rotation about z. The right of the thorax is level as seen from the front.
    tilt_deg = [-angles_deg.get("trunk_flexion", 0.0), angles_deg.get("trunk_lateral_bending", 0.0)]
    y = Rotation.from_euler("ZX", tilt_deg, degrees=True).apply([0.0, 1.0, 0.0])
    z = np.cross([1.0, 0.0, 0.0], y) / np.linalg.norm(np.cross([1.0, 0.0, 0.0], y))
    heading = Rotation.from_euler("z", angles_deg.get("trunk_heading", 0.0), degrees=True).as_matrix()
    thorax = heading @ _WORLD_R_ISB @ np.column_stack([np.cross(y, z), y, z])
    pelvis = thorax @ turned("XY", "spine_lateral_bending", "spine_rotation").T
    points = {"pelvis": np.array([0.3, -0.2, 0.9])}
    points["neck"] = points["pelvis"] + thorax @ [0.0, 0.5, 0.0]
    ears = thorax @ turned("YX", "head_rotation", "head_lateral_bending")
    for side, z in (("left", -1.0), ("right", 1.0)):
        points[f"{side}_ear"] = points["neck"] + thorax @ [0.0, 0.2, 0.0] + ears @ [0.0, 0.0, 0.07 * z]
        points |= _leg(points["pelvis"], pelvis, side, z, turned)
        points |= _arm(points["neck"], thorax, side, z, turned)
    nowhere = np.full(3, np.nan)
    return np.stack([points.get(joint, nowhere) for joint in skeleton.joints])


def _sided(rotation: np.ndarray, side: str) -> np.ndarray:
    return _MIRROR @ rotation @ _MIRROR if side == "left" else rotation


def _leg(pelvis_m, pelvis, side, z, turned):
    hip = pelvis_m + pelvis @ [0.0, 0.0, 0.09 * z]
    thigh = pelvis @ _sided(
        turned("ZXY", *(f"{side}_hip_{name}" for name in ("flexion", "adduction", "rotation"))), side
    )
    knee = hip - 0.42 * thigh[:, 1]
    shank = thigh @ turned("Z", f"{side}_knee_flexion").T
    ankle = knee - 0.4 * shank[:, 1]
    foot = shank @ turned("Z", f"{side}_ankle_dorsiflexion")
    heel = ankle - 0.05 * foot[:, 0] - 0.06 * shank[:, 1]
    toe = heel + 0.22 * foot[:, 0]
    names = ("hip", "knee", "ankle", "heel", "big_toe", "small_toe")
    aside = 0.03 * foot[:, 2]
    return {f"{side}_{n}": m for n, m in zip(names, (hip, knee, ankle, heel, toe - aside, toe + aside), strict=True)}


def _arm(neck_m, thorax, side, z, turned):
    shoulder = neck_m + thorax @ [0.0, 0.0, 0.19 * z]
    # The ISB's elevation is negative.
    plane, elevation = turned("Y", f"{side}_shoulder_elevation_plane"), turned("X", f"{side}_shoulder_elevation").T
    humerus = thorax @ _sided(plane @ elevation @ turned("Y", f"{side}_shoulder_rotation"), side)
    elbow = shoulder - 0.28 * humerus[:, 1]
    forearm = humerus @ turned("Z", f"{side}_elbow_flexion")
    wrist = elbow - 0.25 * forearm[:, 1]
    return {f"{side}_shoulder": shoulder, f"{side}_elbow": elbow, f"{side}_wrist": wrist}


def trajectory(
    positions_m: np.ndarray, skeleton: Skeleton = BODY, covariance_m2: np.ndarray | None = None, fps: float = 50.0
) -> Trajectory:
    """Frames (T, J, 3) as a trajectory."""
    known = np.isfinite(positions_m).all(axis=-1)
    status = np.where(known, int(Status.OBSERVED), int(Status.UNOBSERVABLE))
    return Trajectory(skeleton, np.arange(len(positions_m)) / fps, positions_m, status, covariance_m2)
