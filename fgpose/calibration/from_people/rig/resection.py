"""Where a camera stands that sees points whose places are known."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.geometry.camera import Camera


def resect(
    points_m: Float[np.ndarray, "point 3"],
    undistorted_px: Float[np.ndarray, "point 2"],
    K: Float[np.ndarray, "3 3"],
    inlier_px: float,
    least_points: int,
) -> Float[np.ndarray, "4 4"] | None:
    """world_T_camera by RANSAC with SQPnP (Terzakis and Lourakis 2020), refined on the inliers.

    Args:
        points_m: in the world.
        undistorted_px: their images.
        K: of the camera.
        inlier_px: within this, a point is where the pose has it.
        least_points: how many of them there have to be.

    Returns:
        None where fewer agree.
    """
    import cv2

    if len(points_m) < least_points:
        return None
    cv2.setRNGSeed(0)
    found, rotation, t, inliers = cv2.solvePnPRansac(
        points_m,
        undistorted_px,
        K,
        None,
        iterationsCount=300,
        reprojectionError=inlier_px,
        confidence=0.9999,
        flags=cv2.SOLVEPNP_SQPNP,
    )
    if not found or inliers is None or len(inliers) < least_points:
        return None
    inner = inliers[:, 0].astype(int)
    rotation, t = cv2.solvePnPRefineLM(points_m[inner], undistorted_px[inner], K, None, rotation, t)
    camera = Camera.from_world_to_camera("", (1, 1), np.eye(3), cv2.Rodrigues(rotation)[0], t[:, 0])
    return camera.world_T_camera
