"""Which joints are estimated in which frame, and first guesses of their positions and of the bone lengths."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from fgpose.config import MotionConfig
from fgpose.sampling import parts_of
from fgpose.skeleton import Skeleton


def active_joints(
    guess_m: Float[np.ndarray, "frame joint 3"], time_s: Float[np.ndarray, " frame"], config: MotionConfig
) -> Bool[np.ndarray, "frame joint"]:
    """Whether a joint is estimated in a frame: it has a first guess there or, with a motion model, near in time."""
    known = np.asarray(np.isfinite(guess_m).all(axis=-1))
    if config.model == "none":
        return known
    return time_to_known_s(known, time_s) <= config.max_unseen_s


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


def median_lengths(skeleton: Skeleton, positions_m: Float[np.ndarray, "frame joint 3"]) -> Float[np.ndarray, " length"]:
    """Median over time and both sides of every shared bone length, metres; NaN where a bone is never complete."""
    of_bones = np.concatenate([skeleton.bone_lengths(positions_m[part]) for part in parts_of(len(positions_m))])
    lengths_m = np.full(skeleton.n_lengths, np.nan)
    for length in range(skeleton.n_lengths):
        values = of_bones[:, np.array(skeleton.length_of_bone) == length]
        if np.isfinite(values).any():
            lengths_m[length] = np.nanmedian(values)
    return lengths_m
