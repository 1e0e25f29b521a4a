"""Robust kernels in numpy: loss and weight, as GTSAM defines them. Needs no gtsam."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from jaxtyping import Float

Kernel = Literal["none", "huber", "cauchy", "geman_mcclure", "tukey"]


def robust_loss(
    squared: Float[np.ndarray, "*residuals"], kernel: Kernel, kernel_scale: float
) -> Float[np.ndarray, "*residuals"]:
    """Loss of squared whitened residuals, as GTSAM counts it in the error of a graph: half the square without a kernel.

    Args:
        squared: squared norms of whitened residuals.
        kernel, kernel_scale: as in noise_model.

    Raises:
        ValueError: the kernel is unknown.
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
        case _:
            raise unknown_kernel(kernel)


def robust_weight(
    squared: Float[np.ndarray, "*residuals"], kernel: Kernel, kernel_scale: float
) -> Float[np.ndarray, "*residuals"]:
    """Weight by which a kernel multiplies the information of a residual when it is linearised.

    Args:
        squared: squared norms of whitened residuals.
        kernel, kernel_scale: as in noise_model.

    Raises:
        ValueError: the kernel is unknown.
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
        case _:
            raise unknown_kernel(kernel)


def unknown_kernel(kernel: object) -> ValueError:
    return ValueError(f"unknown kernel {kernel!r}; known: {', '.join(get_args(Kernel))}")
