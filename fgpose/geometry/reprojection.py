"""Reprojection errors of an estimate."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from fgpose.geometry.camera import CameraRig
from fgpose_factors import projection_residual


def reprojection_residual_px(
    undistorted_px: Float[np.ndarray, "frame camera joint 2"],
    rig: CameraRig,
    positions_m: Float[np.ndarray, "frame joint 3"],
) -> Float[np.ndarray, "frame camera joint"]:
    """Distance in undistorted pixels between each detection and the projection of the estimate."""
    return np.linalg.norm(rig.project(positions_m) - undistorted_px, axis=-1)


def linearized_projection(
    undistorted_px: Float[np.ndarray, "frame camera joint 2"],
    rig: CameraRig,
    positions_m: Float[np.ndarray, "frame joint 3"],
) -> tuple[
    Float[np.ndarray, "frame camera joint 2"],
    Float[np.ndarray, "frame camera joint 2 3"],
    Bool[np.ndarray, "frame camera joint"],
]:
    """Projection of the estimate less each detection, undistorted pixels; its Jacobian by the position, 1/m; and where
    they are known. Without a detection, without an estimate, and at or behind a camera they are not, and 0."""
    # Fortran order has the frames innermost: with the coordinates inside, numpy takes several times as long.
    residual_px = np.empty(undistorted_px.shape, order="F")
    jacobian = np.empty((*residual_px.shape, 3), order="F")
    for number, camera in enumerate(rig.cameras):
        of_camera = projection_residual(positions_m, camera.camera_T_world, camera.K, undistorted_px[:, number])
        residual_px[:, number], (jacobian[:, number],) = of_camera
    known = np.ascontiguousarray(np.isfinite(residual_px).all(axis=-1) & np.isfinite(jacobian).all(axis=(-1, -2)))
    residual_px[~known], jacobian[~known] = 0.0, 0.0
    return residual_px, jacobian, known
