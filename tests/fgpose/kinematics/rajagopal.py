"""The coordinates and joints of Rajagopal2016.osim that fgpose writes, and the pose of that model.

From opensim-org/opensim-models, Models/Rajagopal/Rajagopal2016.osim, commit 523578f. Bones are straight here: what the
model has between hips, knees, ankles, shoulders and elbows beside their length is left out, and the elbow's axis, which
leans by 13 degrees, is z.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import Rotation

RANGES = {
    "pelvis_tilt": (-90, 90),
    "pelvis_list": (-90, 90),
    "pelvis_rotation": (-90, 90),
    "pelvis_tx": (-5, 5),
    "pelvis_ty": (-1, 2),
    "pelvis_tz": (-3, 3),
    "hip_flexion": (-30, 120),
    "hip_adduction": (-50, 30),
    "hip_rotation": (-40, 40),
    "knee_angle": (0, 120),
    "ankle_angle": (-40, 30),
    "subtalar_angle": (-20, 20),
    "mtp_angle": (-30, 30),
    "lumbar_extension": (-90, 90),
    "lumbar_bending": (-90, 90),
    "lumbar_rotation": (-90, 90),
    "arm_flex": (-90, 90),
    "arm_add": (-120, 90),
    "arm_rot": (-90, 90),
    "elbow_flex": (0, 150),
    "pro_sup": (0, 90),
    "wrist_flex": (-70, 70),
    "wrist_dev": (-25, 35),
}
"""Degrees and metres; those of limbs without their side."""
HIP_IN_PELVIS_M = np.array([-0.056276, -0.07849, 0.07726])
"""Of the right side."""
_MIRROR = np.diag([1.0, 1.0, -1.0])


def directions(coordinates: Mapping[str, float], side: str) -> dict[str, np.ndarray]:
    """Unit vectors along the limbs of a side (r, l), in the ground: thigh, shank, upper_arm, forearm.

    Every joint of the model turns about z, x and y of its parent, in this order; on the left x and y point the other
    way. The knee turns the shank about -z, the elbow the forearm about z.
    """

    def joint(*names: str) -> np.ndarray:
        angles_deg = [coordinates.get(name, 0.0) for name in names]
        turned = Rotation.from_euler("ZXY"[: len(names)], angles_deg, degrees=True).as_matrix()
        return _MIRROR @ turned @ _MIRROR if side == "l" and names[0].endswith("_l") else turned

    pelvis = joint("pelvis_tilt", "pelvis_list", "pelvis_rotation")
    torso = pelvis @ joint("lumbar_extension", "lumbar_bending", "lumbar_rotation")
    femur = pelvis @ joint(*(f"hip_{name}_{side}" for name in ("flexion", "adduction", "rotation")))
    tibia = femur @ joint(f"knee_angle_{side}").T
    humerus = torso @ joint(*(f"arm_{name}_{side}" for name in ("flex", "add", "rot")))
    ulna = humerus @ joint(f"elbow_flex_{side}")
    bones = {"thigh": femur, "shank": tibia, "upper_arm": humerus, "forearm": ulna}
    return {name: -rotation[:, 1] for name, rotation in bones.items()}


def middle_of_the_hips_m(coordinates: Mapping[str, float]) -> np.ndarray:
    """Where the model's hips are, in the ground."""
    angles_deg = [coordinates[f"pelvis_{name}"] for name in ("tilt", "list", "rotation")]
    origin_m = np.array([coordinates[f"pelvis_{name}"] for name in ("tx", "ty", "tz")])
    return origin_m + Rotation.from_euler("ZXY", angles_deg, degrees=True).apply(HIP_IN_PELVIS_M * [1.0, 1.0, 0.0])
