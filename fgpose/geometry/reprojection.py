"""Reprojection errors of an estimate."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations


def reprojection_residual_px(
    observations: Observations, rig: CameraRig, positions_m: Float[np.ndarray, "frame joint 3"]
) -> Float[np.ndarray, "frame camera joint"]:
    """Distance in undistorted pixels between each detection and the projection of the estimate."""
    return np.linalg.norm(rig.project(positions_m) - rig.undistort(observations.points2d_px), axis=-1)
