"""The midline of the body, by which two detections are compared.

The joints that have no side, and the points halfway between those that have: they are the same whether or not a view
has exchanged left and right, and arms and legs hardly move them.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from fgpose.skeleton import Skeleton

# One point alone may be a false detection. More would leave out people of whom little is seen.
_MIN_FEATURES = 2


def midlines(
    points_px: Float[np.ndarray, "*candidates joint 2"], skeleton: Skeleton
) -> Float[np.ndarray, "*candidates feature 2"]:
    """Points of the midline of each candidate; NaN = missing."""
    left, right = np.array(skeleton.left_right, dtype=int).reshape(-1, 2).T
    middle = [joint for joint in range(skeleton.n_joints) if joint not in {*left.tolist(), *right.tolist()}]
    left_px, right_px = points_px[..., left, :], points_px[..., right, :]
    halfway_px = (left_px + right_px) / 2
    exact_px = np.concatenate([points_px[..., middle, :], halfway_px], axis=-2)
    # Many detectors leave out the side that is turned away; what is left is off by half the width of a body.
    either_px = np.where(np.isnan(halfway_px), np.where(np.isnan(left_px), right_px, left_px), halfway_px)
    rough_px = np.concatenate([points_px[..., middle, :], either_px], axis=-2)
    return np.where(comparable(exact_px)[..., None, None], exact_px, rough_px)


def comparable(midlines_px: Float[np.ndarray, "*candidates feature 2"]) -> Bool[np.ndarray, "*candidates"]:
    """Whether enough of a candidate is known to compare it with a person."""
    n_known = np.isfinite(midlines_px).all(axis=-1).sum(axis=-1)
    return np.asarray(n_known >= min(_MIN_FEATURES, midlines_px.shape[-2]))


def median_distance(distance: Float[np.ndarray, "*pairs feature"]) -> Float[np.ndarray, "*pairs"]:
    """Median over the features that both have; infinite where they have too few in common."""
    common = np.isfinite(distance).sum(axis=-1)
    enough = common >= min(_MIN_FEATURES, distance.shape[-1])
    # Sorting puts NaN last, so the median of what is known lies in the middle of the beginning.
    middle = np.maximum(common - 1, 0) // 2
    median = np.take_along_axis(np.sort(distance, axis=-1), middle[..., None], axis=-1)[..., 0]
    return np.where(enough, median, np.inf)


def median_offset(offsets: Float[np.ndarray, "feature axis"]) -> Float[np.ndarray, " axis"]:
    """Over the features that are known; zero if none is."""
    known = offsets[np.isfinite(offsets).all(axis=-1)]
    return np.median(known, axis=0) if len(known) else np.zeros(offsets.shape[-1])
