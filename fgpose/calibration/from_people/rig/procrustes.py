"""The pose of one camera relative to another from what each sees in 3D by itself: rough, but it cannot be twisted.

An essential matrix from joints that are nearly coplanar, or at one place, has several solutions, and that all points
are in front does not tell which is right. A network's 3D does: on real recordings it is 5 to 15 degrees off, the wrong
solutions by 30 and more.
"""

from __future__ import annotations

import gtsam
import numpy as np
from jaxtyping import Bool, Float

from fgpose.estimation.evidence.presence import MIN_JOINTS

_ITERATIONS = 20  # of the reweighting, which changes the rotation by less than 0.1 degrees after ten
_LEAST_FRAMES = 3
_LEAST_ERROR_M = 0.01  # of a frame, whose weight is 1 / error; networks are not better


def procrustes_pose(
    first_m: Float[np.ndarray, "frame joint 3"], second_m: Float[np.ndarray, "frame joint 3"]
) -> Float[np.ndarray, "4 4"] | None:
    """first_T_second, metres: the rigid motion that lays the joints of the second view on those of the first.

    The rotation is from poses without their place, whose depth is far worse, and robust over frames: the sum of the
    errors of frames is minimised, not of their squares. The translation is the median that goes with it.

    Args:
        first_m, second_m: in the frames of the two cameras; NaN = missing.

    Returns:
        None where both see too little at the same time.
    """
    known = np.asarray(np.isfinite(first_m).all(axis=-1) & np.isfinite(second_m).all(axis=-1))
    enough = known.sum(axis=1) >= MIN_JOINTS
    if enough.sum() < _LEAST_FRAMES:
        return None
    known = known[enough]
    first_m, first_mean_m = centred(first_m[enough], known)
    second_m, second_mean_m = centred(second_m[enough], known)
    products = np.einsum("tja,tjb->tab", first_m, second_m)
    R, weights = np.eye(3), np.ones(len(products))
    for _ in range(_ITERATIONS):
        R = gtsam.Rot3.ClosestTo(np.einsum("t,tab->ab", weights, products)).matrix()
        squared_m2 = np.sum((first_m - second_m @ R.T) ** 2, axis=(1, 2)) / known.sum(axis=1)
        weights = 1 / np.maximum(np.sqrt(squared_m2), _LEAST_ERROR_M)
    first_T_second = np.eye(4)
    first_T_second[:3, :3] = R
    first_T_second[:3, 3] = np.median(first_mean_m - second_mean_m @ R.T, axis=0)
    return first_T_second


def centred(
    points_m: Float[np.ndarray, "frame joint 3"], known: Bool[np.ndarray, "frame joint"]
) -> tuple[Float[np.ndarray, "frame joint 3"], Float[np.ndarray, "frame 3"]]:
    """Joints around the middle of those that are known in the frame, zero where it is not known; and the middle."""
    points_m = np.where(known[..., None], points_m, 0.0)
    mean_m = points_m.sum(axis=1) / np.maximum(known.sum(axis=1), 1)[:, None]
    return np.where(known[..., None], points_m - mean_m[:, None], 0.0), mean_m
