"""What cameras would detect of joints: reprojection by pose, lens and bias of the view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from fgpose_factors.projection import NEAREST_M

N_OF_CAMERA = 11
"""Unknowns of a camera: rotation vector and translation in its own frame, log of the focal length, k1, principal point
(share of the diagonal of the image), time offset."""
ROTATION, TRANSLATION, FOCAL, RADIAL, CENTRE, OFFSET = slice(0, 3), slice(3, 6), 6, 7, slice(8, 10), 10


@dataclass(frozen=True, eq=False)
class Views:
    """Cameras as the adjustment has them."""

    world_T_camera: Float[np.ndarray, "camera 4 4"]
    focal_px: Float[np.ndarray, "camera 2"]
    centre_px: Float[np.ndarray, "camera 2"]
    diagonal_px: Float[np.ndarray, " camera"]
    k1: Float[np.ndarray, " camera"]


@dataclass(frozen=True, eq=False)
class Projected:
    """Pixels and their Jacobians; at or behind a camera these are zero."""

    points_px: Float[np.ndarray, "frame camera joint 2"]
    in_front: Bool[np.ndarray, "frame camera joint"]
    by_joint: Float[np.ndarray, "frame camera joint 2 3"]
    by_camera: Float[np.ndarray, "frame camera joint 2 10"]
    """All unknowns but the time offset."""
    by_bias: Float[np.ndarray, "frame camera joint 2 2"]


def projected(
    joints_m: Float[np.ndarray, "frame joint 3"], bias_m: Float[np.ndarray, "frame camera joint 2"], views: Views
) -> Projected:
    """Where the cameras see joints that they take to be somewhat beside where they are.

    Args:
        joints_m: world frame.
        bias_m: along the axes of the image, metres at the joint.
        views: the cameras. Radial distortion is f n (1 + k1 |n|^2) of a point n at unit focal length, in pixels that
            are undistorted otherwise.
    """
    # p = Exp(-w) R' (x - p0) - t for small w and t, so that dp/dw = [p]x and dp/dt = -1.
    R = views.world_T_camera[:, :3, :3]
    from_camera_m = joints_m[:, None] - views.world_T_camera[:, None, :3, 3]
    own_m = from_camera_m @ R
    depth_m = own_m[..., 2]
    in_front = depth_m > NEAREST_M
    depth_m = np.where(in_front, depth_m, 1.0)
    at_unit = np.where(in_front[..., None], (own_m[..., :2] + bias_m) / depth_m[..., None], 0.0)
    focal_px, k1 = views.focal_px[:, None], views.k1[:, None]
    squared = np.sum(at_unit**2, axis=-1)
    from_centre_px = focal_px * at_unit * (1 + k1 * squared)[..., None]
    by_unit = (1 + k1 * squared)[..., None, None] * np.eye(2) + 2 * k1[..., None, None] * _outer(at_unit)
    by_unit = np.where(in_front[..., None, None], focal_px[..., None] * by_unit, 0.0)
    by_bias = by_unit / depth_m[..., None, None]
    by_own = np.concatenate([by_bias, -np.sum(by_bias * at_unit[..., None, :], axis=-1, keepdims=True)], axis=-1)
    by_lens = np.stack([from_centre_px, focal_px * at_unit * squared[..., None]], axis=-1)
    by_centre = in_front[..., None, None] * views.diagonal_px[:, None, None, None] * np.eye(2)
    return Projected(
        points_px=from_centre_px + views.centre_px[:, None],
        in_front=in_front,
        by_joint=by_own @ R.swapaxes(-1, -2)[:, None],
        by_camera=np.concatenate([_times_cross(by_own, own_m), -by_own, by_lens, by_centre], axis=-1),
        by_bias=by_bias,
    )


def _outer(vectors: Float[np.ndarray, "*points 2"]) -> Float[np.ndarray, "*points 2 2"]:
    return vectors[..., :, None] * vectors[..., None, :]


def _times_cross(
    rows: Float[np.ndarray, "*points 2 3"], points_m: Float[np.ndarray, "*points 3"]
) -> Float[np.ndarray, "*points 2 3"]:
    """rows @ [p]x, which is rows x p for each row: (a' [p]x) b = a . (p x b) = (a x p) . b."""
    return np.cross(rows, points_m[..., None, :])
