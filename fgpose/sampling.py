"""How a recording is sampled in time: its usual step and rate, and frames spread over it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

TIME_ROUNDING_S = 1e-6
"""Times that differ by less are the same."""


def usual_step_s(time_s: Float[np.ndarray, " frame"]) -> float:
    """Median time from frame to frame, seconds; inf with one frame."""
    return float(np.median(np.diff(time_s))) if len(time_s) > 1 else np.inf


def frames_per_second(time_s: Float[np.ndarray, " frame"]) -> float:
    """Of the usual step; NaN with one frame."""
    return 1 / usual_step_s(time_s) if len(time_s) > 1 else np.nan


def nearest(times_s: Float[np.ndarray, " time"], others_s: Float[np.ndarray, " other"]) -> Int[np.ndarray, " time"]:
    """Index of the nearest of the others, at least one, which increase, for each time; of two the earlier."""
    after = np.clip(np.searchsorted(others_s, times_s), 1, max(len(others_s) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(others_s) - 1)
    return np.where(np.abs(others_s[after] - times_s) < np.abs(others_s[before] - times_s), after, before)


def spread_evenly(n_frames: int, at_most: int) -> Int[np.ndarray, " sample"]:
    """Frames spread evenly over a long recording; all of a short one."""
    return np.unique(np.linspace(0, n_frames - 1, min(n_frames, at_most)).round().astype(int))


def stretches(chosen: Bool[np.ndarray, " frame"]) -> list[tuple[int, int]]:
    """First and one past the last of each run of frames that are chosen."""
    edges = np.flatnonzero(np.diff(chosen.astype(int), prepend=0, append=0)).reshape(-1, 2)
    return [(first, end) for first, end in edges.tolist()]


def fair_limits(wanted: Sequence[int] | Sequence[float], total: int | float) -> list[float]:
    """How much of a total each may have at most: all the same, and what some do not want goes to the others."""
    limits = [0.0] * len(wanted)
    for n_served, who in enumerate(sorted(range(len(wanted)), key=lambda each: wanted[each])):
        limits[who] = total / (len(wanted) - n_served)
        total -= min(wanted[who], limits[who])
    return limits


def mean_times_s(time_s: Float[np.ndarray, "frame camera"]) -> Float[np.ndarray, " frame"]:
    """One time per frame: the mean of what is known, of equal times exactly that; NaN where nothing is."""
    known = np.isfinite(time_s)
    counts = known.sum(axis=1)
    first_s = np.where(known, time_s, np.inf).min(axis=1, initial=np.inf)
    later_s = np.where(known, time_s - first_s[:, None], 0.0).sum(axis=1)
    return np.where(counts > 0, first_s + later_s / np.maximum(counts, 1), np.nan)
