"""Depth of a point along the ray of one view, as a monocular estimator gives it."""

from __future__ import annotations

import gtsam
import numpy as np
from jaxtyping import Float

from fgpose_factors.kernels import Kernel
from fgpose_factors.noise import robust

# Across the ray the reprojection factor of the pixel is far more accurate: wide enough to add nothing to it.
LATERAL_SIGMA_M = 1.0


def depth_information(
    direction: Float[np.ndarray, "*rays 3"], sigma_m: Float[np.ndarray, "*rays"]
) -> Float[np.ndarray, "*rays 3 3"]:
    """Information that is large along the ray only, m^-2, in the frame of the directions.

    Args:
        direction: unit vectors.
        sigma_m: standard deviation along them, metres.
    """
    # Not the inverse of a covariance: that is singular in double precision where the two differ by a factor of 1e8.
    along = direction[..., :, None] * direction[..., None, :]
    return along / sigma_m[..., None, None] ** 2 + (np.eye(3) - along) / LATERAL_SIGMA_M**2


def depth_factor(
    key: int,
    point_m: Float[np.ndarray, " 3"],
    direction: Float[np.ndarray, " 3"],
    sigma_m: float,
    kernel: Kernel = "none",
    kernel_scale: float = 1.0,
) -> gtsam.PriorFactorPoint3:
    """GTSAM's native prior on one Point3, with sigma_m along the ray and LATERAL_SIGMA_M across it.

    Args:
        key: of the point, world frame.
        point_m: the view's own 3D point.
        direction: unit vector of the ray.
        sigma_m: standard deviation along the ray, metres.
        kernel, kernel_scale: as in noise_model.

    Raises:
        ValueError: sigma or scale is not positive, or the kernel is unknown.
    """
    if not sigma_m > 0:
        raise ValueError(f"sigma must be positive, got {sigma_m}")
    gaussian = gtsam.noiseModel.Gaussian.Information(depth_information(direction, np.asarray(sigma_m)))
    return gtsam.PriorFactorPoint3(key, point_m, robust(gaussian, kernel, kernel_scale))
