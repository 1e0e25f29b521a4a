"""Reprojection of a 3D point in a known pinhole camera."""

from __future__ import annotations

import gtsam
import numpy as np


def projection_residual(
    point_m: np.ndarray, camera_T_world: np.ndarray, K: np.ndarray, measured_px: np.ndarray
) -> tuple[np.ndarray, tuple[np.ndarray]]:
    """Projected minus measured pixel.

    Args:
        point_m: (..., 3) world point.
        camera_T_world: (4, 4) world to camera.
        K: (3, 3) intrinsics without skew.
        measured_px: (..., 2) undistorted pixel.

    Returns:
        Residual (..., 2) in pixels and its Jacobian (..., 2, 3) by the point. NaN at or behind the camera.
    """
    R, focal_px = camera_T_world[:3, :3], np.diag(K)[:2]
    in_camera = point_m @ R.T + camera_T_world[:3, 3]
    depth_m = np.where(in_camera[..., 2:] > 0, in_camera[..., 2:], np.nan)
    normalized = in_camera[..., :2] / depth_m
    residual = normalized * focal_px + K[:2, 2] - measured_px
    jacobian = focal_px[:, None] / depth_m[..., None] * (R[:2] - normalized[..., None] * R[2])
    return residual, (jacobian,)


def projection_factor(
    key: int, measured_px: np.ndarray, noise: gtsam.noiseModel.Base, camera: gtsam.PinholeCameraCal3_S2
) -> gtsam.TriangulationFactorCal3_S2:
    """GTSAM's native factor on one Point3: projected minus measured, in undistorted pixels.

    A point behind the camera gives GTSAM's constant error of twice the focal length and a zero Jacobian: it neither
    pulls nor fails. A NaN measurement would be ignored in silence and must be kept out by the caller.
    """
    return gtsam.TriangulationFactorCal3_S2(camera, measured_px, noise, key)
