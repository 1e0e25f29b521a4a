"""Per-view 3D goes with the camera that saw it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations


def moved_with_cameras(observations: Observations, before: CameraRig, after: CameraRig) -> Observations:
    """The views' own 3D joints, moved with their cameras."""
    points3d_m, covariance_m2 = observations.points3d_m, observations.covariance3d_m2
    if points3d_m is None:
        return observations
    moves = [new.world_T_camera @ old.camera_T_world for old, new in zip(before.cameras, after.cameras, strict=True)]
    R, t_m = np.stack(moves)[:, None, :3, :3], np.stack(moves)[:, None, :3, 3]
    return replace(
        observations,
        points3d_m=(R @ points3d_m[..., None])[..., 0] + t_m,
        covariance3d_m2=None if covariance_m2 is None else R @ covariance_m2 @ R.swapaxes(-1, -2),
    )
