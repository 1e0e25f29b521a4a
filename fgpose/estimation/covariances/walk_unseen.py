"""How fast somebody goes of whom no camera sees anything for a while: as before and after that."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

_AROUND_S = 0.3  # before and after; at the edges themselves smoothing has slowed the body down


def speed_unseen_mps(
    positions_m: Float[np.ndarray, "frame joint 3"],
    time_s: Float[np.ndarray, " frame"],
    is_seen: Bool[np.ndarray, " frame"],
) -> Float[np.ndarray, " frame"]:
    """The highest speed of the body within 0.3 s before or after the time in which no camera sees it, m/s; 0 elsewhere.

    Args:
        positions_m: of all joints; NaN where not estimated.
        time_s: of the frames.
        is_seen: whether any camera sees any joint.
    """
    speed_mps = np.zeros(len(time_s))
    (seen,) = np.nonzero(is_seen)
    if is_seen.all() or len(seen) < 2:
        return speed_mps
    moved_m, step_s = np.diff(positions_m[seen], axis=0), np.diff(time_s[seen])
    known = np.isfinite(moved_m).all(axis=-1, keepdims=True)
    mean_m = np.where(known, moved_m, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    of_steps_mps = np.linalg.norm(mean_m, axis=-1) / step_s
    middle_s = (time_s[seen][1:] + time_s[seen][:-1]) / 2
    unseen = np.flatnonzero(~is_seen)
    after = np.searchsorted(seen, unseen)
    before_s = time_s[seen[np.maximum(after - 1, 0)]] - _AROUND_S
    after_s = time_s[seen[np.minimum(after, len(seen) - 1)]] + _AROUND_S
    first, last = np.searchsorted(middle_s, before_s), np.searchsorted(middle_s, after_s)
    for frame, begin, end in zip(unseen.tolist(), first.tolist(), last.tolist(), strict=True):
        speed_mps[frame] = of_steps_mps[begin:end].max(initial=0.0)
    return speed_mps
