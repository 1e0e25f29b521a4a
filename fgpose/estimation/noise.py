"""Errors of detections that are correlated in time: n frames carry less information than n independent measurements.

Used wherever errors are counted: covariances, bone lengths, time offsets, the depth of a view.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.sampling import usual_step_s

CORRELATION_S = 0.15
"""Time over which the errors of a pose network are correlated, measured on a monocular network."""
TELLING_HZ = 25.0
"""More images a second tell hardly anything new."""
CORRELATED_FACTOR = 1.2
"""The graph takes errors of consecutive frames for independent. They are not: so much larger must they seem. (6 px
where errors are 5 px gave the least mean error on the tuning clips of the benchmark.)"""
MEMORY_S = 30.0
"""Online, what is learned of errors is forgotten over this time. A network and a light are the same for longer; a
person turns, and a camera may be moved."""
LEAST_SPREAD_M = 0.002
"""No network errs less at a joint, along each axis of the image."""
ROUNDING = 1e-12
"""Of the total variance of a joint. A point next to a camera is known to micrometres in two directions and to a metre
in the third; rounding errors would make the least variance negative."""


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


def shared_errors(time_s: Float[np.ndarray, " frame"]) -> float:
    """By how much standard deviations of what is constant are too small where errors of frames at these times are taken
    for independent: neighbouring frames share theirs."""
    return float(np.sqrt(correlated_frames(usual_step_s(time_s), CORRELATION_S)))


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


def surely_positive(matrices: Float[np.ndarray, "*matrices row row"]) -> Float[np.ndarray, "*matrices row row"]:
    """Covariances or information matrices, the same but for rounding errors, which may have made them singular."""
    trace = np.trace(matrices, axis1=-2, axis2=-1)
    return matrices + ROUNDING * trace[..., None, None] * np.eye(matrices.shape[-1])
