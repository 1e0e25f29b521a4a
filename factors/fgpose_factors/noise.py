"""Noise models: a standard deviation in the residual's unit, and a robust kernel whose scale is in sigmas."""

from __future__ import annotations

from typing import Literal

import gtsam
import numpy as np

Kernel = Literal["none", "huber", "cauchy", "geman_mcclure", "tukey"]

_M_ESTIMATORS = {
    "huber": gtsam.noiseModel.mEstimator.Huber,
    "cauchy": gtsam.noiseModel.mEstimator.Cauchy,
    "geman_mcclure": gtsam.noiseModel.mEstimator.GemanMcClure,
    "tukey": gtsam.noiseModel.mEstimator.Tukey,
}


def noise_model(dim: int, sigma: float, kernel: Kernel = "none", kernel_scale: float = 1.0) -> gtsam.noiseModel.Base:
    """Isotropic Gaussian noise with an optional robust kernel.

    Args:
        dim: dimension of the residual.
        sigma: standard deviation of each component, in the residual's unit.
        kernel: Tukey and Geman-McClure redescend: a far outlier has no pull, so they need a good start.
        kernel_scale: whitened residual, in sigmas, from which the kernel discounts.

    Raises:
        ValueError: sigma or scale is not positive, or the kernel is unknown.
    """
    if not sigma > 0 or not kernel_scale > 0:
        raise ValueError(f"sigma and kernel_scale must be positive, got {sigma} and {kernel_scale}")
    return robust(gtsam.noiseModel.Isotropic.Sigma(dim, sigma), kernel, kernel_scale)


def robust(gaussian: gtsam.noiseModel.Gaussian, kernel: Kernel, kernel_scale: float) -> gtsam.noiseModel.Base:
    """Gaussian noise with a robust kernel, or itself for the kernel "none". Raises ValueError for an unknown kernel."""
    if kernel == "none":
        return gaussian
    if kernel not in _M_ESTIMATORS:
        raise ValueError(f"unknown kernel {kernel!r}; known: none, {', '.join(_M_ESTIMATORS)}")
    return gtsam.noiseModel.Robust.Create(_M_ESTIMATORS[kernel].Create(kernel_scale), gaussian)


def robust_loss(squared: np.ndarray, kernel: Kernel, kernel_scale: float) -> np.ndarray:
    """Loss of squared whitened residuals, as GTSAM counts it in the error of a graph: half the square without a kernel.

    Args:
        squared: squared norms of whitened residuals, of any shape.
        kernel, kernel_scale: as in noise_model.
    """
    scale = kernel_scale**2
    match kernel:
        case "none":
            return 0.5 * squared
        case "huber":
            return np.where(squared <= scale, 0.5 * squared, kernel_scale * (np.sqrt(squared) - 0.5 * kernel_scale))
        case "cauchy":
            return 0.5 * scale * np.log1p(squared / scale)
        case "geman_mcclure":
            return 0.5 * scale * squared / (scale + squared)
        case "tukey":
            return scale / 6 * (1 - (1 - np.minimum(squared / scale, 1.0)) ** 3)


def robust_weight(squared: np.ndarray, kernel: Kernel, kernel_scale: float) -> np.ndarray:
    """Weight by which a kernel multiplies the information of a residual when it is linearised.

    Args:
        squared: squared norms of whitened residuals, of any shape.
        kernel, kernel_scale: as in noise_model.
    """
    scale = kernel_scale**2
    match kernel:
        case "none":
            return np.ones_like(squared)
        case "huber":
            return kernel_scale / np.sqrt(np.maximum(squared, scale))
        case "cauchy":
            return scale / (scale + squared)
        case "geman_mcclure":
            return (scale / (scale + squared)) ** 2
        case "tukey":
            return (1 - np.minimum(squared / scale, 1.0)) ** 2
