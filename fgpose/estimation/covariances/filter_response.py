"""What a filter makes of errors that last.

The graph takes the errors of consecutive frames for independent, and states the variance that a joint then has. A joint
alone that moves with white noise on its acceleration is filtered in a steady state as follows. Of its newest pose, with
z^-1 the delay by one frame, by the alpha-beta filter

    F(z) = (alpha - (alpha - beta) / z) / (1 - (2 - alpha - beta) / z + (1 - alpha) / z^2)

whose gains follow from the tracking index, the ratio of what motion and what detections leave open (Kalata 1984). Once
the frames after it are known, by Wiener's smoother H = S / (S + 1), with S the spectrum of the motion. What they make
of errors of any spectrum, and how far the newest pose deviates from what is known of it later, are integrals over all
frequencies. All of it is stated as a share of the variance of the graph, which bones and hidden joints change.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

import numpy as np
from jaxtyping import Float

# Denser towards 0, where slow filters and lasting errors are: good to 1 % from a tracking index of 1e-4.
_FREQUENCIES = 96
_LEAST_INDEX, _MOST_INDEX = 1e-4, 1e4
# Of the tables, because every update asks: between two indices they err by 0.1 %.
_INDEX_LOGS, _STEP_LOGS = np.linspace(np.log(_LEAST_INDEX), np.log(_MOST_INDEX), 256), 0.01
# Of what a joint alone would have: the robust kernels, and bones, leave less of errors that averages out. Simulated as
# in error_components in seven families of the benchmark: 0.75 to 0.85 of white errors and of those
# that last for 0.15 s, 0.9 to 1.1 of constant ones. Errors that joints share are not averaged over the bones.
_SHARE_OF_ALONE = 0.8


@dataclass(frozen=True, eq=False)
class FilterResponse:
    """Variances of joints, in that of the graph."""

    noise: Float[np.ndarray, "*ways component"]
    """From errors of the detections, each component of the variance that the graph takes for all."""
    motion: Float[np.ndarray, "*ways"]
    """From motion, as rough as the graph takes it."""
    steady: Float[np.ndarray, "*ways"]
    """Variance in the graph, in that of the detections of a frame."""


def filter_responses(
    index: Float[np.ndarray, "*ways"],
    step_s: float,
    times_s: tuple[float, ...],
    model: Literal["none", "random_walk", "constant_velocity"],
    shared: Float[np.ndarray, "*#ways"] | float = 0.0,
) -> tuple[FilterResponse, FilterResponse, FilterResponse]:
    """Of the newest pose, of a smoothed one, and of the difference between them in the variance of the newest.

    Args:
        index: square root of the variance of what motion adds in a step (constant_velocity: with white acceleration
            density q, q step^3; random_walk: q step) over the variance of the detections of a frame.
        step_s: from frame to frame.
        times_s: over which each component of the errors is correlated; 0: white noise, inf: constant.
        model: of the motion.
        shared: correlation of the errors of each joint with those of the joints that bones join to it.
    """
    if model == "none":
        alone = FilterResponse(np.ones((*index.shape, len(times_s))), np.zeros(index.shape), np.ones(index.shape))
        return alone, alone, replace(alone, noise=np.zeros_like(alone.noise))
    table = _table(round(np.log(step_s) / _STEP_LOGS), times_s, model)
    place = (np.log(np.clip(index, _LEAST_INDEX, _MOST_INDEX)) - _INDEX_LOGS[0]) / (_INDEX_LOGS[1] - _INDEX_LOGS[0])
    before = np.minimum(place.astype(int), len(_INDEX_LOGS) - 2)
    along = (place - before)[..., None]
    averaged = (1 - _SHARE_OF_ALONE) * (1 - np.broadcast_to(shared, index.shape)[..., None])
    kept = np.where(np.isinf(times_s), 1.0, 1 - averaged)
    found = ((1 - along) * table[:, before] + along * table[:, before + 1]).reshape(3, *index.shape, len(times_s) + 2)
    newest, smoothed, difference = (
        FilterResponse(kept * each[..., :-2], each[..., -2], each[..., -1]) for each in found
    )
    return newest, smoothed, difference


@lru_cache(maxsize=16)
def _table(
    step_log: int, times_s: tuple[float, ...], model: Literal["random_walk", "constant_velocity"]
) -> Float[np.ndarray, "3 index value"]:
    """Of every index: noise by component as of a joint alone, motion and steady variance of the three responses."""
    step_s = float(np.exp(step_log * _STEP_LOGS))
    places = (np.arange(_FREQUENCIES) + 0.5) / _FREQUENCIES
    frequency, share = np.pi * places**3, 3 * places**2 / _FREQUENCIES
    step, ratio = 1 - np.exp(-1j * frequency), np.exp(_INDEX_LOGS)[:, None]
    if model == "constant_velocity":
        alpha, newest = _newest(ratio, step)
        roughness = ratio**2 * np.abs(2 - step) ** 2 / 4 / np.abs(step) ** 4
    else:
        alpha = (np.sqrt(ratio**4 + 4 * ratio**2) - ratio**2) / 2
        newest = alpha / (alpha + (1 - alpha) * step)
        roughness = ratio**2 / np.abs(step) ** 2
    smoothed = roughness / (1 + roughness)
    spectra = np.stack([_spectrum(step_s / time_s if time_s else np.inf, step) for time_s in times_s], axis=1)

    def response(gain: np.ndarray, constant: float, graph: np.ndarray, total: np.ndarray) -> np.ndarray:
        noise = (np.abs(gain) ** 2 * share) @ spectra
        noise = np.where(np.isinf(times_s), constant, noise) / graph[:, None]
        white = _SHARE_OF_ALONE * ((np.abs(gain) ** 2) @ share) / graph
        return np.column_stack([noise, np.maximum(total / graph - white, 0.0), graph])

    of_newest, of_smoothed = alpha[:, 0], smoothed @ share
    return np.stack(
        [
            response(newest, 1.0, of_newest, of_newest),
            response(smoothed, 1.0, of_smoothed, of_smoothed),
            response(newest - smoothed, 0.0, of_newest, np.maximum(of_newest - of_smoothed, 0.0)),
        ]
    )


def index_of_gain(gain: Float[np.ndarray, "*ways"]) -> Float[np.ndarray, "*ways"]:
    """Tracking index at which the newest frame has this share of the information on a joint."""
    root = np.sqrt(np.clip(1 - gain, 1e-9, 1.0))
    return 2 * (1 - root) ** 2 / root


def _newest(ratio: Float[np.ndarray, "index 1"], step: np.ndarray) -> tuple[Float[np.ndarray, "index 1"], np.ndarray]:
    """Alpha and the alpha-beta filter at each frequency, where step is 1 - 1/z."""
    root = (4 + ratio - np.sqrt(8 * ratio + ratio**2)) / 4
    alpha = 1 - root**2
    beta = 2 * (2 - alpha) - 4 * root
    back = 1 - step
    return alpha, (alpha - (alpha - beta) * back) / (1 - (2 - alpha - beta) * back + (1 - alpha) * back**2)


def _spectrum(decay: float, step: np.ndarray) -> Float[np.ndarray, " frequency"]:
    """Of a first-order Gauss-Markov process of variance 1 that falls by so many powers of e from frame to frame."""
    left = float(np.exp(-decay))
    return (1 - left**2) / np.abs(1 - left * (1 - step)) ** 2
