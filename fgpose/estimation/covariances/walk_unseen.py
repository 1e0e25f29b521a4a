"""How fast somebody goes of whom no camera sees anything for a while: as before and after that."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

_AROUND_S = 0.3  # before and after; at the edges themselves smoothing has slowed the body down


def speed_unseen_mps(
    positions_m: Float[np.ndarray, "all_frames joint 3"],
    frames: Int[np.ndarray, " frame"],
    time_s: Float[np.ndarray, " frame"],
    is_seen: Bool[np.ndarray, " frame"],
) -> Float[np.ndarray, " frame"]:
    """The highest speed of the body within 0.3 s before or after the time in which no camera sees it, m/s; 0 elsewhere.

    Args:
        positions_m: of all joints; NaN where not estimated.
        frames: numbers of those that are asked for.
        time_s: of these.
        is_seen: whether any camera sees any joint.
    """
    speed_mps = np.zeros(len(time_s))
    (seen,) = np.nonzero(is_seen)
    if is_seen.all() or len(seen) < 2:
        return speed_mps
    middle_s = (time_s[seen][1:] + time_s[seen][:-1]) / 2
    unseen = np.flatnonzero(~is_seen)
    after = np.searchsorted(seen, unseen)
    before_s = time_s[seen[np.maximum(after - 1, 0)]] - _AROUND_S
    after_s = time_s[seen[np.minimum(after, len(seen) - 1)]] + _AROUND_S
    first, last = np.searchsorted(middle_s, before_s), np.searchsorted(middle_s, after_s)
    # Of a long recording only the steps that are asked for.
    n_asking = np.bincount(first, minlength=len(seen)) - np.bincount(last, minlength=len(seen))
    steps = np.flatnonzero(np.cumsum(n_asking)[:-1])
    moved_m = positions_m[frames[seen[steps + 1]]] - positions_m[frames[seen[steps]]]
    known = np.isfinite(moved_m).all(axis=-1, keepdims=True)
    mean_m = np.where(known, moved_m, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    of_steps_mps = np.zeros(len(middle_s))
    of_steps_mps[steps] = np.linalg.norm(mean_m, axis=-1) / np.diff(time_s[seen])[steps]
    for frame, begin, end in zip(unseen.tolist(), first.tolist(), last.tolist(), strict=True):
        speed_mps[frame] = of_steps_mps[begin:end].max(initial=0.0)
    return speed_mps
