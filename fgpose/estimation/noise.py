"""Errors of detections that are correlated in time: n frames carry less information than n independent measurements.

Used wherever errors are counted: covariances, bone lengths, time offsets, the depth of a view. And their size is not
the same all the time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.sampling import parts_of, usual_step_s
from fgpose_factors.robust_statistics import medians

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
LEARNED_EVERY_S = 0.03
"""Online. Errors are correlated over 0.15 s and more: frames between tell hardly anything new of them."""
SAME_S = 0.5
"""For so long errors are taken for equally large: a few times as long as they are correlated."""
_FEWEST_STRETCHES = 4  # tell how much they differ
# Of the usual number of measurements. Fewer views see another axis of the errors: two side by side the vertical one.
LEAST_OF_STRETCH = 0.5
_NORMAL_MEDIAN = 0.4549  # of the square of a normal error, in its variance
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


def sizes_over_time(
    found: Float[np.ndarray, " stretch"], measurements: Float[np.ndarray, " stretch"]
) -> Float[np.ndarray, " stretch"]:
    """Variance of the errors in each stretch of SAME_S, in that of all: light, distance and motion change it. See
    share_believed.

    Args:
        found: usual squared error of a stretch, in any unit; of a median, as of errors that grow the largest are taken
            for hallucinated.
        measurements: how many tell it.
    """
    told, sizes = (measurements > LEAST_OF_STRETCH * medians(measurements)) & (found > 0), np.ones(len(found))
    found, measurements = found[told], measurements[told]
    logs = np.log(found * measurements.sum() / np.sum(found * measurements))
    sizes[told] = np.exp(share_believed(logs, measurements) * logs)
    return sizes


def share_believed(
    logs: Float[np.ndarray, " stretch"], measurements: Float[np.ndarray, " stretch"]
) -> Float[np.ndarray, " stretch"]:
    """Of what the logarithms of variances in stretches that follow each other say: as far as they differ by more than
    so many measurements do by chance, which neighbours show (empirical Bayes); there the median, for a change is one
    such step."""
    if len(logs) < _FEWEST_STRETCHES:
        return np.zeros(len(logs))
    of_neighbours = np.diff(logs) ** 2 / (1 / measurements[1:] + 1 / measurements[:-1])
    by_chance = float(medians(of_neighbours)) / _NORMAL_MEDIAN / measurements
    off = logs - np.average(logs, weights=measurements)
    real = max(float(np.average(off**2 - by_chance, weights=measurements)), 0.0)
    return real / np.maximum(real + by_chance, 1e-12)


def sizes_around_frames(
    of_stretch: Callable[[slice], tuple[float, float]], n_frames: int, step_s: float
) -> Float[np.ndarray, " frame"]:
    """The same around each frame of a recording, given what is found in a stretch of frames, and how many measurements
    tell it."""
    parts = parts_of(n_frames, int(np.clip(round(min(SAME_S / step_s, n_frames)), 1, n_frames)))
    found = np.array([of_stretch(part) for part in parts])
    middles = [(part.start + part.stop - 1) / 2 for part in parts]
    return np.interp(np.arange(n_frames), middles, sizes_over_time(*found.T))


def surely_positive(matrices: Float[np.ndarray, "*matrices row row"]) -> Float[np.ndarray, "*matrices row row"]:
    """Covariances or information matrices, the same but for rounding errors, which may have made them singular."""
    trace = np.trace(matrices, axis1=-2, axis2=-1)
    return matrices + ROUNDING * trace[..., None, None] * np.eye(matrices.shape[-1])
