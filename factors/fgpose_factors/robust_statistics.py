"""What is known of normal errors, for those among which some are wrong: medians as standard deviations, and kernels."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

SIGMA_OF_MEDIAN = 1.4826
"""Standard deviation of normal errors, in the median of their absolute values."""
MEDIAN_LENGTH = 1.1774
"""Median length of a two-dimensional error, sqrt(2 ln 2), in its standard deviation along each axis."""
CAUCHY_SCALE = 2.385
"""Of Cauchy's kernel, in standard deviations: 95 % efficient where no error is wrong."""


def medians(values: Float[np.ndarray, "*values"], axis: int = -1) -> Float[np.ndarray, "*medians"]:
    """Along an axis, of finite values. np.median takes five times as long for one frame."""
    ordered, n_values = np.sort(values, axis=axis), values.shape[axis]
    lower, upper = (ordered.take(at, axis=axis) for at in ((n_values - 1) // 2, n_values // 2))
    return np.asarray((lower + upper) / 2)


def known_median(values: Float[np.ndarray, "*values"]) -> float:
    """NaN where nothing is known."""
    known = values[np.isfinite(values)]
    return float(medians(known)) if known.size else np.nan


def known_quantile(values: Float[np.ndarray, "*values"], q: float) -> float:
    """NaN where nothing is known."""
    known = values[np.isfinite(values)]
    return float(np.quantile(known, q, overwrite_input=True)) if known.size else np.nan


def known_medians(values: Float[np.ndarray, "*values"], axis: int = -1) -> Float[np.ndarray, "*medians"]:
    """Along an axis; NaN where nothing is known. np.nanmedian takes ten times as long."""
    lower, upper = _middle(values, axis)
    return np.where(np.isfinite(lower), (lower + upper) / 2, np.nan)


def lower_medians(values: Float[np.ndarray, "*values"], axis: int = -1) -> Float[np.ndarray, "*medians"]:
    """The same, but always one of the values: of an even number the lower of both in the middle."""
    lower, _ = _middle(values, axis)
    return np.where(np.isfinite(lower), lower, np.nan)


def _middle(values: Float[np.ndarray, "*values"], axis: int) -> Float[np.ndarray, "2 ..."]:
    """The lower and the upper of the values in the middle; not finite where nothing is known."""
    ordered, n_known = np.sort(values, axis=axis), np.isfinite(values).sum(axis=axis, keepdims=True)
    middle = np.maximum(n_known - 1, 0) // 2, n_known // 2
    return np.stack([np.take_along_axis(ordered, at, axis=axis).squeeze(axis) for at in middle])


def weighted_median(values: Float[np.ndarray, " value"], weights: Float[np.ndarray, " value"]) -> float:
    order = np.argsort(values)
    cumulated = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(cumulated, cumulated[-1] / 2)])


def robust_sigma(errors: Float[np.ndarray, "*errors"]) -> float:
    """Standard deviation of normal errors around zero of which a minority is wrong; NaN are left out."""
    return SIGMA_OF_MEDIAN * float(np.nanmedian(np.abs(errors)))
