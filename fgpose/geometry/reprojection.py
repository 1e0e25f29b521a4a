"""Reprojection errors of an estimate."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.geometry.camera import CameraRig


def reprojection_residual_px(
    undistorted_px: Float[np.ndarray, "frame camera joint 2"],
    rig: CameraRig,
    positions_m: Float[np.ndarray, "frame joint 3"],
) -> Float[np.ndarray, "frame camera joint"]:
    """Distance in undistorted pixels between each detection and the projection of the estimate."""
    return np.linalg.norm(rig.project(positions_m) - undistorted_px, axis=-1)
