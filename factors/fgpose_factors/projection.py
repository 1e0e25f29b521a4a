"""Reprojection of a 3D point in a known pinhole camera."""

from __future__ import annotations

import gtsam
import numpy as np
from jaxtyping import Float

NEAREST_M = 0.01
"""Nothing is seen nearer than this: towards the camera the Jacobian, and with it the information, has no bound."""


def projection_residual(
    point_m: Float[np.ndarray, "*points 3"],
    camera_T_world: Float[np.ndarray, "4 4"],
    K: Float[np.ndarray, "3 3"],
    measured_px: Float[np.ndarray, "*points 2"],
) -> tuple[Float[np.ndarray, "*points 2"], tuple[Float[np.ndarray, "*points 2 3"]]]:
    """Projected minus measured pixel.

    Args:
        point_m: world points.
        camera_T_world: world to camera.
        K: intrinsics without skew.
        measured_px: undistorted pixels.

    Returns:
        Residual in pixels and its Jacobian by the point. NaN behind the camera and within NEAREST_M of its plane.
    """
    (projected_px,), (jacobian,) = project(point_m.reshape(-1, 3), camera_T_world[None], K[None])
    shape = point_m.shape[:-1]
    return projected_px.T.reshape(*shape, 2) - measured_px, (jacobian.transpose(2, 0, 1).reshape(*shape, 2, 3),)


def project(
    points_m: Float[np.ndarray, "point 3"],
    camera_T_world: Float[np.ndarray, "camera 4 4"],
    K: Float[np.ndarray, "camera 3 3"],
) -> tuple[Float[np.ndarray, "camera 2 point"], Float[np.ndarray, "camera 2 3 point"]]:
    """Undistorted pixels of points in several cameras, and their Jacobians by the points; otherwise as
    projection_residual. All points of a coordinate lie side by side: with the coordinates inside, numpy takes seven
    times as long."""
    R, focal_px = camera_T_world[:, :3, :3], np.diagonal(K, axis1=1, axis2=2)[:, :2, None]
    in_camera = R @ points_m.T + camera_T_world[:, :3, 3:]
    depth_m = np.where(in_camera[:, 2:] > NEAREST_M, in_camera[:, 2:], np.nan)
    normalized = in_camera[:, :2] / depth_m
    across = R[:, :2, :, None] - normalized[:, :, None] * R[:, 2:, :, None]
    return focal_px * normalized + K[:, :2, 2:], (focal_px / depth_m)[:, :, None] * across


def projection_factor(
    key: int, measured_px: Float[np.ndarray, " 2"], noise: gtsam.noiseModel.Base, camera: gtsam.PinholeCameraCal3_S2
) -> gtsam.TriangulationFactorCal3_S2:
    """GTSAM's native factor on one Point3: projected minus measured, in undistorted pixels.

    A point behind the camera gives GTSAM's constant error of twice the focal length and a zero Jacobian: it neither
    pulls nor fails. A NaN measurement would be ignored in silence and must be kept out by the caller.
    """
    return gtsam.TriangulationFactorCal3_S2(camera, measured_px, noise, key)
