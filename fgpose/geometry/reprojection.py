"""Reprojection errors of an estimate."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from fgpose.geometry.camera import CameraRig
from fgpose.geometry.vectors import norm
from fgpose.sampling import parts_of
from fgpose_factors import project


def reprojection_residual_px(
    undistorted_px: Float[np.ndarray, "frame camera joint 2"],
    rig: CameraRig,
    positions_m: Float[np.ndarray, "frame joint 3"],
) -> Float[np.ndarray, "frame camera joint"]:
    """Distance in undistorted pixels between each detection and the projection of the estimate."""
    residual_px = np.empty(undistorted_px.shape[:-1])
    for part in parts_of(len(positions_m)):
        residual_px[part] = norm(rig.project(positions_m[part]) - undistorted_px[part])
    return residual_px


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
    n_frames, n_cameras, n_joints = undistorted_px.shape[:3]
    projected_px, jacobian = project(positions_m.reshape(-1, 3), rig.camera_T_world, rig.K)
    residual_px = projected_px - undistorted_px.transpose(1, 3, 0, 2).reshape(n_cameras, 2, -1)
    known = np.asarray(np.isfinite(residual_px).all(axis=1))  # and then the Jacobian is
    np.copyto(residual_px, 0.0, where=~known[:, None])
    np.copyto(jacobian, 0.0, where=~known[:, None, None])

    def by_frame(
        of_points: Float[np.ndarray, "camera *values point"],
    ) -> Float[np.ndarray, "frame camera joint *values"]:
        """A view: with the values inside, numpy takes several times as long."""
        values = of_points.shape[1:-1]
        by_camera = of_points.reshape(n_cameras, *values, n_frames, n_joints)
        return by_camera.transpose(-2, 0, -1, *range(1, 1 + len(values)))

    return by_frame(residual_px), by_frame(jacobian), np.ascontiguousarray(by_frame(known))
