"""From which side a camera sees a body: the errors of a network on a joint depend on it."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from fgpose.sampling import nearest
from fgpose.skeleton import Skeleton

N_SECTORS = 8
"""Of the full circle around the axis of the trunk."""


def sectors(
    joints_m: Float[np.ndarray, "frame joint 3"],
    skeleton: Skeleton,
    positions_m: Float[np.ndarray, "camera 3"],
    n_sectors: int = N_SECTORS,
) -> Int[np.ndarray, "frame camera"]:
    """Sector in which each camera stands, counted from straight behind the body over its right side.

    Frames in which the trunk is not known take that of the nearest in which it is; all are 0 without any.

    Args:
        joints_m: of the whole skeleton; NaN = not known.
        skeleton: with limbs, or all sectors are 0.
        positions_m: of the cameras.
        n_sectors: of the circle.
    """
    unknown = np.zeros((len(joints_m), len(positions_m)), dtype=int)
    if not skeleton.limb_pairs:
        return unknown
    shoulders, hips = (skeleton.limb_pairs[limb] for limb in (0, 2))
    left_m = joints_m[:, [shoulders[0][0], hips[0][0]]]
    right_m = joints_m[:, [shoulders[1][0], hips[1][0]]]
    to_left = (left_m - right_m).sum(axis=1)
    up = (left_m + right_m)[:, 0] - (left_m + right_m)[:, 1]
    forward = np.cross(to_left, up)
    to_left = np.cross(up, forward)
    to_camera = positions_m - (left_m + right_m).mean(axis=1)[:, None] / 2
    azimuth = np.arctan2(_along(to_camera, to_left), _along(to_camera, forward))
    known = np.flatnonzero(np.isfinite(azimuth).all(axis=1))
    if not known.size:
        return unknown
    azimuth = azimuth[known[nearest(np.arange(len(azimuth)).astype(float), known.astype(float))]]
    return np.floor((azimuth / (2 * np.pi) + 0.5) * n_sectors).astype(int) % n_sectors


def _along(
    vectors_m: Float[np.ndarray, "frame camera 3"], axis_m: Float[np.ndarray, "frame 3"]
) -> Float[np.ndarray, "frame camera"]:
    length_m = np.linalg.norm(axis_m, axis=-1)[:, None]
    products = np.einsum("tca,ta->tc", vectors_m, axis_m)
    return np.divide(products, length_m, out=np.full_like(products, np.nan), where=length_m > 0)
