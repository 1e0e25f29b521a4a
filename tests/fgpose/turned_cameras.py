"""Rigs whose calibration is wrong."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from fgpose.geometry.camera import CameraRig


def turned(rig: CameraRig, camera: int, degrees: float) -> CameraRig:
    """The rig with one camera turned about its own vertical axis."""
    turn = np.eye(4)
    turn[:3, :3] = cv2.Rodrigues(np.deg2rad([0.0, degrees, 0.0]))[0]
    cameras = list(rig.cameras)
    cameras[camera] = replace(cameras[camera], world_T_camera=cameras[camera].world_T_camera @ turn)
    return CameraRig(tuple(cameras))
