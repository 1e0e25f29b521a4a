"""How far a camera's own 3D says that joints are from it: what per-view 3D tells beside the detections."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.geometry.vectors import norm

RELATIVE_SIGMA = 0.043
"""Standard deviation of a network's distances, over the distance, where none is stated and the recording does not tell:
measured on BlazePose, 150 mm at 3.5 m."""
_NEAREST_M = 1e-3  # no image is in focus there, and from there every direction is near


@dataclass(frozen=True, eq=False)
class ViewDepth:
    """Distances of joints from the camera, along their rays; NaN without 3D, or with one within 1 mm of the camera."""

    rays: Float[np.ndarray, "*joints 3"]
    """Unit vectors from the camera to the joints, world frame."""
    distance_m: Float[np.ndarray, "*joints"]
    sigma_m: Float[np.ndarray, "*joints"]
    """Standard deviation of the distance as the covariance states it; NaN where there is none."""

    @staticmethod
    def of(
        points3d_m: Float[np.ndarray, "*joints 3"],
        covariance3d_m2: Float[np.ndarray, "*joints 3 3"] | None,
        position_m: Float[np.ndarray, "*#joints 3"],
    ) -> ViewDepth:
        """Of joints in the world frame, from where the camera is."""
        from_camera_m = points3d_m - position_m
        distance_m = norm(from_camera_m)
        distance_m = np.where(distance_m > _NEAREST_M, distance_m, np.nan)
        rays = from_camera_m / distance_m[..., None]
        if covariance3d_m2 is None:
            return ViewDepth(rays, distance_m, np.full(distance_m.shape, np.nan))
        variance_m2 = np.einsum("...i,...ik,...k->...", rays, covariance3d_m2, rays)
        return ViewDepth(rays, distance_m, np.sqrt(np.maximum(variance_m2, 0.0)))
