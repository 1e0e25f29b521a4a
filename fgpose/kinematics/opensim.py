"""Coordinates of OpenSim's full-body model (Rajagopal et al. 2016), as far as joints determine them.

Names, axes and signs are those of Rajagopal2016.osim in opensim-org/opensim-models. Rotations are about z, x and y of
the parent segment, in this order, with flexion, adduction and internal rotation positive; knee_angle is positive in
flexion (in gait2392 it is negative). The pelvis is tilted with the trunk, for joint centres do not tell its own tilt:
lumbar_extension is zero, and hip_flexion is that against the trunk.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.geometry.up_axis import WorldUp, z_up
from fgpose.kinematics.angles import angles_deg
from fgpose.kinematics.landmarks import landmarks, points_of
from fgpose.kinematics.segments import TRUNK, pelvis
from fgpose.trajectory import Trajectory

_OF_A_SIDE = {
    "hip_flexion": "hip_flexion",
    "hip_adduction": "hip_adduction",
    "hip_rotation": "hip_rotation",
    "knee_angle": "knee_flexion",
    "ankle_angle": "ankle_dorsiflexion",
    "arm_flex": "arm_flexion",
    "arm_add": "arm_adduction",
    "arm_rot": "arm_rotation",
    "elbow_flex": "elbow_flexion",
}
# OpenSim's ground has y up. The world's axes are mapped as in the TRC files of Pose2Sim and fgpose, which then fit.
_GROUND_R_WORLD = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
# Origin of the unscaled model's pelvis from the middle of its hips (hip_r and hip_l in the file), in the pelvis.
_ORIGIN_FROM_HIPS_M = np.array([0.056276, 0.07849, 0.0])


def opensim_coordinates(trajectory: Trajectory, world_up: WorldUp = "z") -> dict[str, Float[np.ndarray, " frame"]]:
    """Values by coordinate: degrees; pelvis_tx, pelvis_ty and pelvis_tz in metres; NaN = not determined.

    pelvis_rotation does not jump at 180 degrees: somebody who has turned round is at 360.

    Raises:
        ValueError: the skeleton determines no angle.
    """
    angles = angles_deg(trajectory, world_up, arms_in_zxy=True)
    coordinates = _pelvis(trajectory, world_up)
    for side in ("right", "left"):
        for name, angle in _OF_A_SIDE.items():
            if f"{side}_{angle}" in angles:
                coordinates[f"{name}_{side[0]}"] = angles[f"{side}_{angle}"]
    if "spine_rotation" in angles:
        coordinates["lumbar_extension"] = np.where(np.isnan(angles["spine_rotation"]), np.nan, 0.0)
        coordinates["lumbar_bending"] = angles["spine_lateral_bending"]
        coordinates["lumbar_rotation"] = angles["spine_rotation"]
    return coordinates


def _pelvis(trajectory: Trajectory, world_up: WorldUp) -> dict[str, Float[np.ndarray, " frame"]]:
    """Its rotation, and where its origin is if the model's hips are in the middle of ours, in OpenSim's ground."""
    from scipy.spatial.transform import Rotation

    joints = landmarks(trajectory.skeleton)
    if not joints.keys() >= set(TRUNK):
        return {}
    points = points_of(z_up(trajectory.positions_m, world_up), joints)
    ground_R_pelvis = _GROUND_R_WORLD @ pelvis(points)
    known = np.isfinite(ground_R_pelvis).all(axis=(-2, -1))
    turned_deg = np.full((trajectory.n_frames, 3), np.nan)
    if known.any():
        turned_deg[known] = Rotation.from_matrix(ground_R_pelvis[known]).as_euler("ZXY", degrees=True)
        turned_deg[known, 2] = np.unwrap(turned_deg[known, 2], period=360.0)
    hips_m = (points["left_hip"] + points["right_hip"]) / 2 @ _GROUND_R_WORLD.T
    origin_m = hips_m + ground_R_pelvis @ _ORIGIN_FROM_HIPS_M
    names = ("pelvis_tilt", "pelvis_list", "pelvis_rotation", "pelvis_tx", "pelvis_ty", "pelvis_tz")
    return dict(zip(names, np.concatenate([turned_deg, origin_m], axis=1).T, strict=True))
