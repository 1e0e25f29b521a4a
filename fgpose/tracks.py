"""Where a joint is seen, where it can be estimated, and a first guess of it."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from fgpose.config import MotionConfig
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Status


def active_joints(
    guess_m: Float[np.ndarray, "frame joint 3"], time_s: Float[np.ndarray, " frame"], config: MotionConfig
) -> Bool[np.ndarray, "frame joint"]:
    """Whether a joint takes part in a frame: it has a first guess there or, with a motion model, near in time."""
    known = np.asarray(np.isfinite(guess_m).all(axis=-1))
    if config.model == "none":
        return known
    return np.stack([_near(time_s, time_s[known[:, j]], config.max_unseen_s) for j in range(known.shape[1])], axis=1)


def _near(time_s: np.ndarray, known_s: np.ndarray, distance_s: float) -> np.ndarray:
    if known_s.size == 0:
        return np.zeros(time_s.shape, dtype=bool)
    after = np.searchsorted(known_s, time_s).clip(0, known_s.size - 1)
    before = (after - 1).clip(0)
    nearest_s = np.minimum(np.abs(known_s[after] - time_s), np.abs(time_s - known_s[before]))
    return nearest_s <= distance_s


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
