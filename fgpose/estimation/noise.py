"""Errors of detections that are correlated in time: n frames carry less information than n independent measurements.

Used wherever errors are counted: covariances, bone lengths, time offsets, the depth of a view.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

CORRELATION_S = 0.15
"""Time over which the errors of a pose network are correlated, measured on a monocular network."""
CORRELATED_FACTOR = 1.2
"""The graph takes errors of consecutive frames for independent. They are not: so much larger must they seem. (6 px
where errors are 5 px gave the least mean error on the tuning clips of the benchmark.)"""
# The rest of the information of the graph is that of bones and motion, whose errors are others. Fitted to the coverage
# on the tuning clips of the benchmark, clean and occluded.
_SHARE_OF_DETECTIONS = 0.5
# So much of the variance of the graph is that of bones and motion: white errors of the variance that the graph takes
# for them make the rest (simulated by fgpose.estimation.error_components in four families of the benchmark: 0.37 to
# 0.42).
_VARIANCE_OF_MOTION = 0.4
# Keep the formula finite where a frame alone knows nothing, or after a pause; both are beyond any real recording.
_MAX_FRAMES = 1e4
_MAX_STEP_S = 1e3
# Of the total variance of a joint. A point next to a camera is known to micrometres in two directions and to a metre in
# the third; rounding errors would make the least variance negative.
_ROUNDING = 1e-12
_LEAST_FACTOR = 0.05  # what is left of a variance where nothing errs
_SHORT = 1e-4  # there both forms of the mean correlation are good to 1e-7


@dataclass(frozen=True)
class ErrorCorrelation:
    """Errors of detections as white noise and a first-order Gauss-Markov process."""

    share: float = 0.64
    """Of the variance that is correlated as exp(-t / time_s); by default as measured on a network (4 of 5 px)."""
    time_s: float = CORRELATION_S


def correlated_frames(
    step_s: float | Float[np.ndarray, "*frames"], correlation_s: float
) -> float | Float[np.ndarray, "*frames"]:
    """How many frames count as one measurement when errors are correlated over this time; at least one."""
    return np.maximum(1.0, 2 * correlation_s / step_s)


def with_correlated_errors(
    covariance_m2: Float[np.ndarray, "*joints 3 3"],
    frame_information: Float[np.ndarray, "*joints 3 3"],
    step_s: float,
    variances: Float[np.ndarray, "*joints component"],
    times_s: Sequence[float],
) -> Float[np.ndarray, "*joints 3 3"]:
    """The covariance of the graph, scaled to what it would be with correlated errors.

    The mean of n frames, h apart, of errors of variance 1 that are correlated as exp(-t / tau) has the variance
    g(n h / tau) instead of 1 / n, with g(u) = 2 (u - 1 + exp(-u)) / u^2.

    Args:
        covariance_m2: of the graph, in which errors are independent.
        frame_information: of the detections of each frame alone, 1/m^2.
        step_s: time from frame to frame.
        variances: of the components of the errors, in those of the graph.
        times_s: over which each component is correlated; 0: white noise, inf: constant.
    """
    covariance_m2 = surely_positive(covariance_m2)
    information = np.trace(np.linalg.inv(covariance_m2), axis1=-2, axis2=-1)
    alone = np.trace(frame_information, axis1=-2, axis2=-1)
    n_frames = _SHARE_OF_DETECTIONS * information / np.maximum(alone, information / _MAX_FRAMES)
    n_frames, step_s = np.maximum(n_frames, 1.0), min(step_s, _MAX_STEP_S)  # less than one frame cannot be averaged
    factor = np.full(n_frames.shape, _VARIANCE_OF_MOTION)
    for component, time_s in enumerate(times_s):
        of_mean = np.maximum(n_frames * _mean_correlation(n_frames * step_s / time_s), 1.0) if time_s > 0 else 1.0
        factor = factor + variances[..., component] * (of_mean - _VARIANCE_OF_MOTION)
    return covariance_m2 * np.maximum(factor, _LEAST_FACTOR)[..., None, None]


def shrunk(
    own: float | Float[np.ndarray, "*shape"],
    measurements: float | Float[np.ndarray, "*shape"],
    usual: float | Float[np.ndarray, "*#shape"],
    prior_measurements: float,
) -> Float[np.ndarray, "*shape"]:
    """A scale, variance or density that so many measurements tell, shrunk towards what is usual, by ratios: such
    numbers differ by orders of magnitude."""
    logs = measurements * np.log(own) + prior_measurements * np.log(usual)
    return np.asarray(np.exp(logs / (measurements + prior_measurements)))


def surely_positive(matrices: Float[np.ndarray, "*joints 3 3"]) -> Float[np.ndarray, "*joints 3 3"]:
    """Covariances or information matrices, the same but for rounding errors, which may have made them singular."""
    trace = np.trace(matrices, axis1=-2, axis2=-1)
    return matrices + _ROUNDING * trace[..., None, None] * np.eye(3)


def _mean_correlation(duration: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """Mean of exp(-|a - b|) over all a and b in [0, duration]."""
    # For a short duration the subtractions cancel all digits: take the series.
    exact = 2 * (duration - 1 + np.exp(-duration)) / np.maximum(duration, _SHORT) ** 2
    return np.where(duration > _SHORT, exact, 1 - duration / 3)
