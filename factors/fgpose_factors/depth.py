"""Depth of a point along the ray of one view, as a monocular estimator gives it."""

from __future__ import annotations

import gtsam
import numpy as np

from fgpose_factors.noise import Kernel, robust

# Where the ray runs is known better from the pixel, whose own factor says so: wide enough to add nothing to it.
LATERAL_SIGMA_M = 1.0


def depth_covariance_m2(direction: np.ndarray, sigma_m: np.ndarray) -> np.ndarray:
    """Covariance that is narrow along the ray only.

    Args:
        direction: (..., 3) unit vectors.
        sigma_m: (...) standard deviation along them, metres.

    Returns:
        (..., 3, 3) in m^2, in the frame of the directions.
    """
    along = direction[..., :, None] * direction[..., None, :]
    return sigma_m[..., None, None] ** 2 * along + LATERAL_SIGMA_M**2 * (np.eye(3) - along)


def depth_factor(
    key: int,
    point_m: np.ndarray,
    direction: np.ndarray,
    sigma_m: float,
    kernel: Kernel = "none",
    kernel_scale: float = 1.0,
) -> gtsam.PriorFactorPoint3:
    """GTSAM's native prior on one Point3, with sigma_m along the ray and LATERAL_SIGMA_M across it.

    Args:
        key: of the point, world frame.
        point_m: (3,) where the view alone sees it.
        direction: (3,) unit vector of the ray.
        sigma_m: standard deviation along the ray, metres.
        kernel, kernel_scale: as in noise_model.
    """
    covariance_m2 = depth_covariance_m2(np.asarray(direction), np.asarray(sigma_m))
    gaussian = gtsam.noiseModel.Gaussian.Covariance(covariance_m2)
    return gtsam.PriorFactorPoint3(key, point_m, robust(gaussian, kernel, kernel_scale))
