"""The unit of a scene that the images tell but for its size: that of the views' 3D, or that of a body."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from fgpose.geometry.camera import CameraRig
from fgpose.skeleton import Skeleton

TORSO_M = 0.5
"""From hip to shoulder, where no 3D tells the unit: a rough guess, which metric.py replaces."""


def unit_of(
    scene: Float[np.ndarray, "frame joint 3"],
    views_m: Float[np.ndarray, "frame camera joint 3"] | None,
    skeleton: Skeleton,
    joints: Int[np.ndarray, " joint"],
) -> float:
    """What a scene is to be multiplied by.

    Args:
        scene: joints in any frame and unit; NaN = not known.
        views_m: the same as each view alone has them, metres, or None.
        skeleton: of which these are some joints.
        joints: which; with the shoulders and hips where the skeleton has limbs.
    """
    if views_m is not None:
        known = np.asarray(np.isfinite(scene).all(axis=-1))[:, None] & np.isfinite(views_m).all(axis=-1)
        known &= known.sum(axis=-1, keepdims=True) >= 2
        sizes = [_sizes(np.broadcast_to(points, views_m.shape), known) for points in (views_m, scene[:, None])]
        ratios = sizes[0][known.any(axis=-1)] / sizes[1][known.any(axis=-1)]
        if ratios.size:
            return float(np.median(ratios))
    return TORSO_M / _torso(scene, skeleton, joints)


def scaled(rig: CameraRig, unit: float) -> CameraRig:
    """The rig with all distances multiplied."""
    poses = [camera.world_T_camera.copy() for camera in rig.cameras]
    for pose in poses:
        pose[:3, 3] *= unit
    pairs = zip(rig.cameras, poses, strict=True)
    return CameraRig(tuple(replace(camera, world_T_camera=pose) for camera, pose in pairs))


def _sizes(points: Float[np.ndarray, "frame camera joint 3"], known: np.ndarray) -> Float[np.ndarray, "frame camera"]:
    """Root mean square distance from the mean of the joints that are known."""
    count, points = np.maximum(known.sum(axis=-1), 1), np.where(known[..., None], points, 0.0)
    from_mean = points - (points.sum(axis=-2) / count[..., None])[..., None, :]
    return np.sqrt(np.sum(np.where(known[..., None], from_mean, 0.0) ** 2, axis=(-2, -1)) / count)


def _torso(scene: Float[np.ndarray, "frame joint 3"], skeleton: Skeleton, joints: Int[np.ndarray, " joint"]) -> float:
    """Median over frames; of a skeleton without limbs, the median size of the body."""
    if not skeleton.limb_pairs:
        known = np.asarray(np.isfinite(scene).all(axis=-1))[:, None]
        return float(np.median(_sizes(scene[:, None], known)[known.sum(axis=-1) >= 2]))
    place = {int(joint): number for number, joint in enumerate(joints)}
    sides = zip(skeleton.limb_pairs[0], skeleton.limb_pairs[2], strict=True)
    torsos = [scene[:, place[shoulder[0]]] - scene[:, place[hip[0]]] for shoulder, hip in sides]
    return float(np.nanmedian(np.linalg.norm(torsos, axis=-1)))
