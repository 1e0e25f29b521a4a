"""Errors of detections that are correlated in time: n frames carry less information than n independent measurements.

Used wherever errors are counted: covariances, bone lengths, time offsets, the depth of a view.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.parameters import CalibrationConfig

CORRELATION_S = CalibrationConfig.error_correlation_s
"""Time over which the errors of a pose network are correlated. Always the default: _EQUAL_FRAMES was fitted with it."""
# Share of the variance of a visible detection that is correlated (4 of 5 px), measured on the same network.
_CORRELATED_SHARE = 0.64
# The information of the whole graph over that of one frame counts frames of unequal weight. Fitted with the factors in
# fgpose.estimation.uncertainty.
_EQUAL_FRAMES = 0.35
# Keep the formula finite where a frame alone knows nothing, or after a pause; both are beyond any real recording.
_MAX_FRAMES = 1e4
_MAX_STEP_S = 1e3
# Of the total variance of a joint. A point next to a camera is known to micrometres in two directions and to a metre in
# the third; rounding errors would make the least variance negative.
_ROUNDING = 1e-12
_SHORT = 1e-4  # there both forms of the mean correlation are good to 1e-7


def correlated_frames(
    step_s: float | Float[np.ndarray, " frame"], correlation_s: float
) -> float | Float[np.ndarray, " frame"]:
    """How many frames count as one measurement when errors are correlated over this time; at least one."""
    return np.maximum(1.0, 2 * correlation_s / step_s)


def with_correlated_errors(
    covariance_m2: Float[np.ndarray, "*joints 3 3"],
    frame_information: Float[np.ndarray, "*joints 3 3"],
    step_s: float,
) -> Float[np.ndarray, "*joints 3 3"]:
    """The covariance of the graph, scaled to what it would be with correlated errors.

    The mean of n frames, h apart, of which a share s of the variance is correlated as exp(-t / tau), has the variance
    (1 - s + s n g(n h / tau)) / n instead of 1 / n, with g(u) = 2 (u - 1 + exp(-u)) / u^2.

    Args:
        covariance_m2: of the graph, in which errors are independent.
        frame_information: of the detections of each frame alone, 1/m^2.
        step_s: time from frame to frame.
    """
    trace_m2 = np.trace(covariance_m2, axis1=-2, axis2=-1)
    covariance_m2 = covariance_m2 + _ROUNDING * trace_m2[..., None, None] * np.eye(3)
    information = np.trace(np.linalg.inv(covariance_m2), axis1=-2, axis2=-1)
    alone = np.trace(frame_information, axis1=-2, axis2=-1)
    n_frames = np.clip(_EQUAL_FRAMES * information / np.maximum(alone, information / _MAX_FRAMES), 1e-3, None)
    step_s = min(step_s, _MAX_STEP_S)
    mean_correlation = _mean_correlation(n_frames * step_s / CORRELATION_S)
    factor = 1 - _CORRELATED_SHARE + _CORRELATED_SHARE * n_frames * mean_correlation
    return covariance_m2 * np.maximum(factor, 1.0)[..., None, None]  # less than one frame cannot be averaged


def _mean_correlation(duration: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """Mean of exp(-|a - b|) over all a and b in [0, duration]."""
    # For a short duration the subtractions cancel all digits: take the series.
    exact = 2 * (duration - 1 + np.exp(-duration)) / np.maximum(duration, _SHORT) ** 2
    return np.where(duration > _SHORT, exact, 1 - duration / 3)
