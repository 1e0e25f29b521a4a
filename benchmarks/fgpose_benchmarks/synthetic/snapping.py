"""Detections of an occluded joint that snap to another joint: the other wrist, the nearest limb."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.skeleton import Skeleton


def shown_joints(
    rng: np.random.Generator,
    occluded: Bool[np.ndarray, "frame camera joint"],
    true_px: Float[np.ndarray, "frame camera joint 2"],
    skeleton: Skeleton,
    snap_share: float,
) -> Int[np.ndarray, "frame camera joint"]:
    """Index of the joint that each detection shows: its own, or another during a stretch of occlusion that snaps.

    The other is the mirrored joint, seen or not; of a joint without one, the nearest that is visible when the stretch
    begins. A joint without either does not snap.
    """
    n_frames, n_cameras, n_joints = occluded.shape
    shown = np.tile(np.arange(n_joints), (n_frames, n_cameras, 1))
    if snap_share == 0:
        return shown
    # One draw for each detection, of which the first of a stretch counts: streams do not depend on the stretches.
    draws = rng.random(occluded.shape)
    for camera, joint in np.ndindex(n_cameras, n_joints):
        for start, end in stretches(occluded[:, camera, joint]):
            if draws[start, camera, joint] < snap_share:
                shown[start:end, camera, joint] = _other(
                    joint, skeleton, true_px[start, camera], ~occluded[start, camera]
                )
    return shown


def stretches(on: Bool[np.ndarray, " frame"]) -> Iterator[tuple[int, int]]:
    """First frame, and the one after the last, of every stretch."""
    edges = np.flatnonzero(np.diff(on.astype(int), prepend=0, append=0))
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)


def _other(
    joint: int, skeleton: Skeleton, true_px: Float[np.ndarray, "joint 2"], visible: Bool[np.ndarray, " joint"]
) -> int:
    (mirrored, _) = skeleton.mirrored((joint, joint))
    if mirrored != joint:
        return mirrored
    distance_px = np.linalg.norm(true_px - true_px[joint], axis=-1)
    distance_px[~visible] = np.inf
    nearest = int(np.nanargmin(distance_px)) if np.isfinite(distance_px).any() else joint
    return nearest if np.isfinite(distance_px[nearest]) else joint
