"""Cameras of images that were turned by quarter turns after they were recorded, as upright pictures of a camera that
lies on its side."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.shown.unknown_names import check_names

_CLOCKWISE = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def turn_images(rig: CameraRig, quarter_turns: Mapping[str, int]) -> CameraRig:
    """The same cameras, whose images were turned clockwise after they were recorded: their keypoints are of the turned
    images, the calibration of those as recorded.

    Args:
        rig: calibrated for the images as recorded.
        quarter_turns: by camera; -1 is 90 degrees counter-clockwise. The images of the others were not turned.

    Raises:
        ValueError: a camera is unknown.
    """
    check_names(quarter_turns, rig.names, "the calibration has no camera", "it has")
    cameras = []
    for camera in rig.cameras:
        for _ in range(quarter_turns.get(camera.name, 0) % 4):
            camera = _turned_clockwise(camera)
        cameras.append(camera)
    return CameraRig(tuple(cameras))


def _turned_clockwise(camera: Camera) -> Camera:
    width, height = camera.size_px
    K = np.array([[camera.K[1, 1], 0.0, height - 1 - camera.K[1, 2]], [0.0, camera.K[0, 0], camera.K[0, 2]], [0, 0, 1]])
    distortion = camera.distortion.copy()
    if camera.lens == "pinhole" and distortion.size:
        distortion[2:4] = camera.distortion[3], -camera.distortion[2]
    world_T_camera = camera.world_T_camera.copy()
    world_T_camera[:3, :3] = camera.world_T_camera[:3, :3] @ _CLOCKWISE.T
    return replace(camera, size_px=(height, width), K=K, distortion=distortion, world_T_camera=world_T_camera)
