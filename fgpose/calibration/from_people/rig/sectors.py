"""From which side a camera sees a body: the errors of a network on a joint depend on it."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from fgpose.calibration.adjustment.sightings import SeenFrom
from fgpose.sampling import nearest
from fgpose.skeleton import Skeleton

_LEAST_SLANT = 0.2  # sine of the angle between the trunk and the optical axis: 12 degrees
N_SECTORS = 8
"""Of the full circle around the axis of the trunk."""


def seen_from(
    joints_m: Float[np.ndarray, "frame joint 3"],
    skeleton: Skeleton,
    world_T_camera: Float[np.ndarray, "camera 4 4"],
    n_sectors: int,
) -> SeenFrom:
    """How cameras stand to a body in each frame, from joints of the whole skeleton, NaN = not known."""
    if not n_sectors:
        return SeenFrom.anywhere(len(joints_m), len(world_T_camera))
    sector = sectors(joints_m, skeleton, world_T_camera[:, :3, 3], n_sectors)
    return SeenFrom(np.eye(n_sectors)[sector], upright(joints_m, skeleton, world_T_camera))


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
    left_m, right_m = _sides_m(joints_m, skeleton)
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


def upright(
    joints_m: Float[np.ndarray, "frame joint 3"], skeleton: Skeleton, world_T_camera: Float[np.ndarray, "camera 4 4"]
) -> Float[np.ndarray, "camera 2 2"]:
    """Axes of each image, in columns, with respect to the body: to its right and down, however a camera is rolled.

    Those of the image where the trunk is not known or points at the camera.

    Args:
        joints_m: of the whole skeleton; NaN = not known.
        skeleton: with limbs.
        world_T_camera: poses of the cameras.
    """
    axes = np.tile(np.eye(2), (len(world_T_camera), 1, 1))
    if not skeleton.limb_pairs:
        return axes
    left_m, right_m = _sides_m(joints_m, skeleton)
    up = (left_m + right_m)[:, 0] - (left_m + right_m)[:, 1]
    up = up[np.isfinite(up).all(axis=1)]
    if not len(up):
        return axes
    down = -np.median(up, axis=0) @ world_T_camera[:, :3, :3]
    length = np.linalg.norm(down[:, :2], axis=1)
    seen = length > _LEAST_SLANT * np.linalg.norm(down, axis=1)
    down = down[seen, :2] / length[seen, None]
    axes[seen] = np.stack([np.stack([down[:, 1], -down[:, 0]], axis=-1), down], axis=-1)
    return axes


def _sides_m(
    joints_m: Float[np.ndarray, "frame joint 3"], skeleton: Skeleton
) -> tuple[Float[np.ndarray, "frame 2 3"], Float[np.ndarray, "frame 2 3"]]:
    """Shoulder and hip, left and right."""
    shoulders, hips = skeleton.limb_pairs[0], skeleton.limb_pairs[2]
    left_m, right_m = (joints_m[:, [shoulders[side][0], hips[side][0]]] for side in (0, 1))
    return left_m, right_m


def _along(
    vectors_m: Float[np.ndarray, "frame camera 3"], axis_m: Float[np.ndarray, "frame 3"]
) -> Float[np.ndarray, "frame camera"]:
    length_m = np.linalg.norm(axis_m, axis=-1)[:, None]
    products = np.einsum("tca,ta->tc", vectors_m, axis_m)
    return np.divide(products, length_m, out=np.full_like(products, np.nan), where=length_m > 0)
