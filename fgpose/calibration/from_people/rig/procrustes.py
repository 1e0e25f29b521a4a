"""The pose of one camera relative to another from what each sees in 3D by itself: rough, but it cannot be twisted.

An essential matrix from joints that are nearly coplanar, or at one place, has several solutions, and that all points
are in front does not tell which is right. A network's 3D does: on real recordings it is 5 to 15 degrees off, the wrong
solutions by 30 and more.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

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
    first_m, first_mean_m = _centred(first_m[enough], known)
    second_m, second_mean_m = _centred(second_m[enough], known)
    products = np.einsum("tja,tjb->tab", first_m, second_m)
    R, weights = np.eye(3), np.ones(len(products))
    for _ in range(_ITERATIONS):
        R = nearest_rotation(np.einsum("t,tab->ab", weights, products))
        squared_m2 = np.sum((first_m - second_m @ R.T) ** 2, axis=(1, 2)) / known.sum(axis=1)
        weights = 1 / np.maximum(np.sqrt(squared_m2), _LEAST_ERROR_M)
    first_T_second = np.eye(4)
    first_T_second[:3, :3] = R
    first_T_second[:3, 3] = np.median(first_mean_m - second_mean_m @ R.T, axis=0)
    return first_T_second


def nearest_rotation(matrix: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
    """The rotation that maximises trace(R' M) (Kabsch 1976)."""
    u, _, vt = np.linalg.svd(matrix)
    return u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt


def angle_deg(first: Float[np.ndarray, "3 3"], second: Float[np.ndarray, "3 3"]) -> float:
    """Between two rotations."""
    cosine = (np.trace(first.T @ second) - 1) / 2
    return float(np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0))))


def _centred(
    points_m: Float[np.ndarray, "frame joint 3"], known: np.ndarray
) -> tuple[Float[np.ndarray, "frame joint 3"], Float[np.ndarray, "frame 3"]]:
    points_m = np.where(known[..., None], points_m, 0.0)
    mean_m = points_m.sum(axis=1) / known.sum(axis=1)[:, None]
    return np.where(known[..., None], points_m - mean_m[:, None], 0.0), mean_m
