"""Noise models: a standard deviation in the residual's unit, and a robust kernel whose scale is in sigmas."""

from __future__ import annotations

import gtsam

from fgpose_factors.kernels import Kernel, unknown_kernel

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
    if not sigma > 0:
        raise ValueError(f"sigma must be positive, got {sigma}")
    return robust(gtsam.noiseModel.Isotropic.Sigma(dim, sigma), kernel, kernel_scale)


def robust(gaussian: gtsam.noiseModel.Gaussian, kernel: Kernel, kernel_scale: float) -> gtsam.noiseModel.Base:
    """Any Gaussian noise with a robust kernel; for the kernel "none" the Gaussian noise itself.

    Args:
        gaussian: noise of any covariance.
        kernel, kernel_scale: as in noise_model.

    Raises:
        ValueError: the scale is not positive, or the kernel is unknown.
    """
    if not kernel_scale > 0:
        raise ValueError(f"kernel_scale must be positive, got {kernel_scale}")
    if kernel == "none":
        return gaussian
    if kernel not in _M_ESTIMATORS:
        raise unknown_kernel(kernel)
    return gtsam.noiseModel.Robust.Create(_M_ESTIMATORS[kernel].Create(kernel_scale), gaussian)
