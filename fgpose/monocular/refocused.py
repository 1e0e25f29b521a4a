"""What a view alone says of the depth, once the lens is known better."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fgpose.geometry.camera import Camera
from fgpose.monocular.network import People


def refocused(people: People, before: Camera, after: Camera) -> People:
    """People whose absolute 3D was computed with one camera, as it is with other intrinsics of the same camera.

    The distance of a body follows from its size in the image, so it grows with the focal length; the differences of
    depth within the body are the network's and stay; across the ray each joint stays on its detection. First order in
    the depth of the body over its distance; detecting again would give the exact figures, at the price of the network.

    Args:
        people: in the frame of the camera.
        before: with which they were computed.
        after: the same camera with its focal length or distortion corrected.
    """
    if np.array_equal(before.K, after.K) and np.array_equal(before.distortion, after.distortion):
        return people
    ratio = float(np.sqrt(after.K[0, 0] * after.K[1, 1] / (before.K[0, 0] * before.K[1, 1])))
    depth_m = np.asarray(people.points3d_m[..., 2], dtype=float)
    known = np.isfinite(depth_m)
    count = np.maximum(known.sum(axis=1, keepdims=True), 1)
    distance_m = np.where(known, depth_m, 0.0).sum(axis=1, keepdims=True) / count
    depth_m = depth_m + (ratio - 1) * distance_m
    undistorted = after.undistort(np.asarray(people.points2d_px, dtype=float))
    on_ray = (undistorted - after.K[:2, 2]) / np.diag(after.K)[:2]
    points3d_m = np.concatenate([on_ray * depth_m[..., None], depth_m[..., None]], axis=-1)
    stretch = np.diag([1.0, 1.0, ratio])
    return replace(people, points3d_m=points3d_m, covariance_m2=stretch @ people.covariance_m2 @ stretch)
