"""Camera rigs for synthetic scenes."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.geometry.camera import Camera, CameraRig


def ring_rig(
    n_cameras: int = 4,
    radius_m: float = 4.5,
    height_m: float = 1.7,
    target_m: tuple[float, float, float] = (0.0, 0.0, 1.0),
    focal_px: float = 1145.0,
    size_px: tuple[int, int] = (1000, 1000),
) -> CameraRig:
    """Cameras evenly on a circle around the vertical (z) through the target, looking at it; by default Human3.6M-like.

    Raises:
        ValueError: there is no camera, or the radius is not positive.
    """
    if radius_m <= 0:
        raise ValueError(f"the radius of a ring of cameras must be positive, got {radius_m:g} m")
    K = np.array([[focal_px, 0, size_px[0] / 2], [0, focal_px, size_px[1] / 2], [0, 0, 1]])
    azimuths = np.pi / 4 + 2 * np.pi * np.arange(n_cameras) / max(n_cameras, 1)
    target = np.array(target_m)
    cameras = []
    for number, azimuth in enumerate(azimuths):
        position_m = np.array([*(target[:2] + radius_m * np.array([np.cos(azimuth), np.sin(azimuth)])), height_m])
        cameras.append(Camera(f"ring_{number}", size_px, K, look_at(position_m, target), np.zeros(0)))
    return CameraRig(tuple(cameras))


def look_at(position_m: Float[np.ndarray, " 3"], target_m: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "4 4"]:
    forward = (target_m - position_m) / np.linalg.norm(target_m - position_m)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    world_T_camera = np.eye(4)
    world_T_camera[:3, :3] = np.column_stack([right, np.cross(forward, right), forward])
    world_T_camera[:3, 3] = position_m
    return world_T_camera
