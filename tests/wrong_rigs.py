"""Rigs whose calibration is wrong, or of another world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from fgpose.geometry.camera import CameraRig


def turned(
    rig: CameraRig, camera: int, degrees: float, axis: Sequence[float] = (0.0, 1.0, 0.0), right_m: float = 0.0
) -> CameraRig:
    """The rig with one camera turned about an axis of its own, the vertical one, and moved to its right."""
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_rotvec(np.deg2rad(degrees) * np.array(axis)).as_matrix()
    turn[0, 3] = right_m
    cameras = list(rig.cameras)
    cameras[camera] = replace(cameras[camera], world_T_camera=cameras[camera].world_T_camera @ turn)
    return CameraRig(tuple(cameras))


def in_another_world(
    rig: CameraRig, scale: float = 1.0, R: np.ndarray | None = None, shift_m: Sequence[float] = (0.0, 0.0, 0.0)
) -> CameraRig:
    """The same cameras in another world: x_new = scale * R x + shift_m."""
    R = np.eye(3) if R is None else R
    cameras = []
    for camera in rig.cameras:
        pose = np.eye(4)
        pose[:3, :3] = R @ camera.world_T_camera[:3, :3]
        pose[:3, 3] = scale * R @ camera.position_m + shift_m
        cameras.append(replace(camera, world_T_camera=pose))
    return CameraRig(tuple(cameras))
