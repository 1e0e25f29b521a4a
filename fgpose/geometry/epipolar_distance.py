"""How well two cameras agree on what both saw, without any 3D: distances from epipolar lines, and from epipolar
geometry."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.geometry.vectors import norm


def essential_matrix(camera_T_other: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "3 3"]:
    """E with x_camera^T E x_other = 0 in the images at unit focal length (Hartley and Zisserman 2004, eq. 9.12)."""
    x, y, z = camera_T_other[:3, 3]
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) @ camera_T_other[:3, :3]


def epipolar_distances_px(
    undistorted_px: Float[np.ndarray, "*points 2"],
    others_px: Float[np.ndarray, "*points 2"],
    camera: Camera,
    other: Camera,
) -> Float[np.ndarray, " *points"]:
    """Distance in a camera's image of points from the epipolar lines of the same points in another camera.

    Args:
        undistorted_px: of the camera; NaN = missing.
        others_px: undistorted pixels of the other camera.
        camera: in whose image the distance is measured.
        other: whose rays are the lines.
    """
    essential = essential_matrix(camera.camera_T_world @ other.world_T_camera)
    fundamental = np.linalg.inv(camera.K).T @ essential @ np.linalg.inv(other.K)
    lines = np.concatenate([others_px, np.ones((*others_px.shape[:-1], 1))], axis=-1) @ fundamental.T
    distances = np.abs(np.sum(lines[..., :2] * undistorted_px, axis=-1) + lines[..., 2])
    return np.asarray(distances / norm(lines[..., :2]))


def sampson_errors(
    F: Float[np.ndarray, "3 3"], first: Float[np.ndarray, "point 2"], second: Float[np.ndarray, "point 2"]
) -> Float[np.ndarray, " point"]:
    """Signed distances of correspondences from the epipolar constraint x_second^T F x_first = 0, to first order
    (Hartley and Zisserman 2004, eq. 11.9): of errors that are alike in both images, the standard deviation of one
    coordinate."""
    line, other_line = first @ F[:, :2].T + F[:, 2], second @ F[:2] + F[2]
    algebraic = second[:, 0] * line[:, 0] + second[:, 1] * line[:, 1] + line[:, 2]
    square = line[:, 0] ** 2 + line[:, 1] ** 2 + other_line[:, 0] ** 2 + other_line[:, 1] ** 2
    return algebraic / np.sqrt(np.maximum(square, 1e-18))


def pairs_px(
    undistorted_px: Float[np.ndarray, "frame camera joint 2"], rig: CameraRig
) -> Float[np.ndarray, "frame camera other"]:
    """Median over the joints of each frame of the distance in each camera from the lines of each other one; NaN where
    they see no joint together, and for a camera with itself."""
    n_frames, n_cameras = undistorted_px.shape[:2]
    medians = np.full((n_frames, n_cameras, n_cameras), np.nan)
    for c, camera in enumerate(rig.cameras):
        for o, other in enumerate(rig.cameras):
            if o != c:
                own_px, others_px = undistorted_px[:, c], undistorted_px[:, o]
                distances_px = epipolar_distances_px(own_px, others_px, camera, other)
                known = np.isfinite(distances_px).any(axis=1)
                medians[known, c, o] = np.nanmedian(distances_px[known], axis=1)
    return medians
