"""Errors of detections that are correlated in time: n frames carry less information than n independent measurements.

Used wherever errors are counted: covariances, bone lengths, time offsets, the depth of a view.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from fgpose.parameters import CalibrationConfig

CORRELATION_S = CalibrationConfig.error_correlation_s
"""Time over which the errors of a pose network are correlated. Always the default."""
CORRELATED_FACTOR = 1.2
"""The graph takes errors of consecutive frames for independent. They are not: so much larger must they seem. (6 px
where errors are 5 px gave the least mean error on the tuning clips of the benchmark.)"""
# The rest of the information of the graph is that of bones and motion, whose errors are others. Fitted to the coverage
# on the tuning clips of the benchmark, clean and occluded.
_SHARE_OF_DETECTIONS = 0.5
# Keep the formula finite where a frame alone knows nothing, or after a pause; both are beyond any real recording.
_MAX_FRAMES = 1e4
_MAX_STEP_S = 1e3
# Of the total variance of a joint. A point next to a camera is known to micrometres in two directions and to a metre in
# the third; rounding errors would make the least variance negative.
_ROUNDING = 1e-12
_SHORT = 1e-4  # there both forms of the mean correlation are good to 1e-7
# The autocorrelation is taken up to this lag, at so many of them. What is left there counts as constant.
_LONGEST_LAG_S, _MOST_LAGS = 1.0, 16
_TIMES_S = np.geomspace(0.02, 0.5, 12)  # of a first-order process that are told apart from white and constant errors
_GOOD_WEIGHT = 0.3  # detections with less are left out: hallucinations have correlations of their own
# So many pairs of detections, counted as independent, outweigh what is usual. One camera and one joint give 7 a second.
_PRIOR_PAIRS = 100.0


@dataclass(frozen=True)
class ErrorCorrelation:
    """Errors of detections as white noise, a first-order Gauss-Markov process, and a constant for each joint in each
    camera."""

    share: float = 0.64
    """Of the variance that is correlated as exp(-t / time_s); by default as measured on a network (4 of 5 px)."""
    time_s: float = CORRELATION_S
    constant_share: float = 0.0
    """Of the variance that is constant."""


def correlated_frames(
    step_s: float | Float[np.ndarray, "*frames"], correlation_s: float
) -> float | Float[np.ndarray, "*frames"]:
    """How many frames count as one measurement when errors are correlated over this time; at least one."""
    return np.maximum(1.0, 2 * correlation_s / step_s)


def error_correlation(
    residual: Float[np.ndarray, "frame camera joint 2"],
    weights: Float[np.ndarray, "frame camera joint"],
    step_s: float,
) -> ErrorCorrelation:
    """How the errors of a recording are correlated, fitted to the autocorrelation of the residuals.

    Args:
        residual: against the smoothed motion, in any unit that makes them comparable; NaN without a detection.
        weights: of the detections.
        step_s: time from frame to frame.
    """
    usual = ErrorCorrelation()
    known = np.isfinite(residual).all(axis=-1) & (weights > _GOOD_WEIGHT)
    errors = np.where(known[..., None], residual, 0.0)
    longest = min(int(_LONGEST_LAG_S / step_s), len(errors) - 1)
    if longest < 2:
        return usual
    lags = np.unique(np.geomspace(1, longest, _MOST_LAGS).astype(int))
    correlation, pairs = np.array([_autocorrelation(errors, known, lag) for lag in lags.tolist()]).T
    lags_s, pairs = lags * step_s, pairs / correlated_frames(step_s, CORRELATION_S)
    # The usual model stands for pairs of its own.
    expected = usual.share * np.exp(-lags_s / usual.time_s) + usual.constant_share
    correlation = (pairs * correlation + _PRIOR_PAIRS * expected) / (pairs + _PRIOR_PAIRS)
    return min((_fitted(correlation, lags_s, time_s) for time_s in _TIMES_S.tolist()), key=lambda fit: fit[0])[1]


def _autocorrelation(
    errors: Float[np.ndarray, "frame camera joint 2"], known: Bool[np.ndarray, "frame camera joint"], lag: int
) -> tuple[float, float]:
    """At a lag in frames, and how many pairs of detections it is from."""
    early, late, both = errors[:-lag], errors[lag:], known[:-lag] & known[lag:]
    variance = float(np.sum(both[..., None] * (early**2 + late**2))) / 2
    return (float(np.sum(early * late)) / variance if variance > 0 else 0.0), float(both.sum())


def _fitted(correlation: np.ndarray, lags_s: np.ndarray, time_s: float) -> tuple[float, ErrorCorrelation]:
    """Misfit and fit of the shares, with this time."""
    from scipy.optimize import nnls

    shares, misfit = nnls(np.stack([np.exp(-lags_s / time_s), np.ones_like(lags_s)], axis=1), correlation)
    share, constant_share = (shares / max(1.0, shares.sum())).tolist()
    return misfit, ErrorCorrelation(share, time_s, constant_share)


def with_correlated_errors(
    covariance_m2: Float[np.ndarray, "*joints 3 3"],
    frame_information: Float[np.ndarray, "*joints 3 3"],
    step_s: float,
    errors: ErrorCorrelation,
) -> Float[np.ndarray, "*joints 3 3"]:
    """The covariance of the graph, scaled to what it would be with correlated errors.

    The mean of n frames, h apart, of which a share s of the variance is correlated as exp(-t / tau) and a share b is
    constant, has the variance (1 - s - b + s n g(n h / tau) + b n) / n instead of 1 / n, with
    g(u) = 2 (u - 1 + exp(-u)) / u^2.

    Args:
        covariance_m2: of the graph, in which errors are independent.
        frame_information: of the detections of each frame alone, 1/m^2.
        step_s: time from frame to frame.
        errors: how they are correlated.
    """
    trace_m2 = np.trace(covariance_m2, axis1=-2, axis2=-1)
    covariance_m2 = covariance_m2 + _ROUNDING * trace_m2[..., None, None] * np.eye(3)
    information = np.trace(np.linalg.inv(covariance_m2), axis1=-2, axis2=-1)
    alone = np.trace(frame_information, axis1=-2, axis2=-1)
    n_frames = _SHARE_OF_DETECTIONS * information / np.maximum(alone, information / _MAX_FRAMES)
    step_s = min(step_s, _MAX_STEP_S)
    correlated = errors.share * _mean_correlation(n_frames * step_s / errors.time_s) + errors.constant_share
    factor = 1 - errors.share - errors.constant_share + n_frames * correlated
    return covariance_m2 * np.maximum(factor, 1.0)[..., None, None]  # less than one frame cannot be averaged


def _mean_correlation(duration: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """Mean of exp(-|a - b|) over all a and b in [0, duration]."""
    # For a short duration the subtractions cancel all digits: take the series.
    exact = 2 * (duration - 1 + np.exp(-duration)) / np.maximum(duration, _SHORT) ** 2
    return np.where(duration > _SHORT, exact, 1 - duration / 3)
