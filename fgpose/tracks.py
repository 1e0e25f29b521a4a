"""Where a joint is seen, where it can be estimated, and a first guess of it."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.config import MotionConfig
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Status


def usual_step_s(time_s: Float[np.ndarray, " frame"]) -> float:
    """Median time from frame to frame, seconds; inf with one frame."""
    return float(np.median(np.diff(time_s))) if len(time_s) > 1 else np.inf


def frames_per_second(time_s: Float[np.ndarray, " frame"]) -> float:
    """Of the usual step; NaN with one frame."""
    return 1 / usual_step_s(time_s) if len(time_s) > 1 else np.nan


def spread_evenly(n_frames: int, at_most: int) -> Int[np.ndarray, " sample"]:
    """Frames spread evenly over a long recording; all of a short one."""
    return np.unique(np.linspace(0, n_frames - 1, min(n_frames, at_most)).round().astype(int))


def frames_alike(
    step_s: float | Float[np.ndarray, " frame"], correlation_s: float
) -> float | Float[np.ndarray, " frame"]:
    """How many frames count as one measurement where errors stay alike for so long; at least one."""
    return np.maximum(1.0, 2 * correlation_s / step_s)


def active_joints(
    guess_m: Float[np.ndarray, "frame joint 3"], time_s: Float[np.ndarray, " frame"], config: MotionConfig
) -> Bool[np.ndarray, "frame joint"]:
    """Whether a joint takes part in a frame: it has a first guess there or, with a motion model, near in time."""
    known = np.asarray(np.isfinite(guess_m).all(axis=-1))
    if config.model == "none":
        return known
    return time_to_known_s(known, time_s) <= config.max_unseen_s


def kept_joints(active: Bool[np.ndarray, "frame joint"], config: MotionConfig) -> Bool[np.ndarray, "frame joint"]:
    """Whether a joint is tied to itself in the frame before; where it takes part and is not, it enters the graph."""
    kept = np.zeros_like(active)
    if config.model != "none":
        kept[1:] = active[1:] & active[:-1]
    return kept


def time_to_known_s(
    known: Bool[np.ndarray, "frame joint"], time_s: Float[np.ndarray, " frame"]
) -> Float[np.ndarray, "frame joint"]:
    """Time to the nearest frame, earlier or later, in which the joint is known; inf if there is none."""
    apart_s = np.full(known.shape, np.inf)
    for joint in range(known.shape[1]):
        known_s = time_s[known[:, joint]]
        if known_s.size:
            after = np.searchsorted(known_s, time_s).clip(0, known_s.size - 1)
            before = (after - 1).clip(0)
            apart_s[:, joint] = np.minimum(np.abs(known_s[after] - time_s), np.abs(time_s - known_s[before]))
    return apart_s


def fill_gaps(
    guess_m: Float[np.ndarray, "frame joint 3"], time_s: Float[np.ndarray, " frame"]
) -> Float[np.ndarray, "frame joint 3"]:
    """First guesses interpolated linearly in time, held constant beyond the ends; a joint without any stays NaN."""
    filled = guess_m.copy()
    for joint in range(guess_m.shape[1]):
        known = np.isfinite(guess_m[:, joint]).all(axis=-1)
        if known.any() and not known.all():
            for axis in range(3):
                filled[:, joint, axis] = np.interp(time_s, time_s[known], guess_m[known, joint, axis])
    return filled


def joint_status(active: Bool[np.ndarray, "*frames joint"], observed: Bool[np.ndarray, "*frames joint"]) -> np.ndarray:
    """Status of every joint and frame, of the same shape."""
    status = np.where(active & observed, Status.OBSERVED, Status.PREDICTED)
    return np.where(active, status, Status.UNOBSERVABLE).astype(np.int8)


def median_lengths(skeleton: Skeleton, positions_m: Float[np.ndarray, "frame joint 3"]) -> Float[np.ndarray, " length"]:
    """Median over time and both sides of every shared bone length, metres; NaN where a bone is never complete."""
    of_bones = skeleton.bone_lengths(positions_m)
    lengths_m = np.full(skeleton.n_lengths, np.nan)
    for length in range(skeleton.n_lengths):
        values = of_bones[:, np.array(skeleton.length_of_bone) == length]
        if np.isfinite(values).any():
            lengths_m[length] = np.nanmedian(values)
    return lengths_m
