"""Rigs whose calibration is wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fgpose.camera import CameraRig


def turned(rig: CameraRig, camera: int, degrees: float) -> CameraRig:
    """The rig with one camera turned about its own vertical axis."""
    angle = np.radians(degrees)
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    pose = rig.cameras[camera].world_T_camera.copy()
    pose[:3, :3] = pose[:3, :3] @ turn
    cameras = list(rig.cameras)
    cameras[camera] = replace(cameras[camera], world_T_camera=pose)
    return CameraRig(tuple(cameras))
