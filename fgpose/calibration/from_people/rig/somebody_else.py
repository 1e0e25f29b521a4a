"""Views that show somebody else than the walker, as where a camera alone exchanged two people who met."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from fgpose.calibration.from_people.rig.evidence import body_radius_px
from fgpose.calibration.from_people.starts.starts import Starts
from fgpose.calibration.from_people.starts.together import seen_at
from fgpose.calibration.from_people.walk import Track, Walk
from fgpose.estimation.evidence.presence import MIN_JOINTS
from fgpose.geometry.camera import CameraRig

# Radii of the body (0.5 m), of the middle of its joints: errors of detections move it by a tenth of that, and of people
# who are nearer to each other than that it hardly matters who is who.
ELSEWHERE = 0.6
_FEW = 0.02  # of the frames of a camera: the robust kernel bears more


def with_the_walker(
    walk: Walk,
    tracks: Mapping[str, Sequence[Track]],
    starts: Starts,
    rig: CameraRig,
    joints_m: Float[np.ndarray, "frame joint 3"],
) -> Walk:
    """A walk whose views show the body on which most cameras agree, where a camera sees it at all.

    Args:
        walk: what was taken for the walker.
        tracks: of each camera, everybody.
        starts: the clocks of the cameras.
        rig: that the walk was calibrated to.
        joints_m: of the walk, robustly triangulated; NaN = not known.

    Returns:
        The walk itself where hardly anything is to be changed. A camera that is elsewhere in most frames is left as it
        is: there it is the camera that is wrong.
    """
    for c, name in enumerate(walk.camera_names):
        walk = _with_the_walker(walk, c, tracks[name], starts, rig, joints_m)
    return walk


def _with_the_walker(
    walk: Walk,
    c: int,
    tracks: Sequence[Track],
    starts: Starts,
    rig: CameraRig,
    joints_m: Float[np.ndarray, "frame joint 3"],
) -> Walk:
    """In one camera."""
    radius_px = body_radius_px(walk.points2d_px[:, c])
    there_px = rig.cameras[c].project(joints_m)

    def radii_away(points2d_px: Float[np.ndarray, "frame joint 2"]) -> Float[np.ndarray, " frame"]:
        return offset_px(rig.cameras[c].undistort(points2d_px), there_px) / radius_px

    away = radii_away(walk.points2d_px[:, c])
    is_known, elsewhere = np.isfinite(away), away > ELSEWHERE
    points2d_px, confidence = walk.points2d_px[:, c].copy(), walk.confidence[:, c].copy()
    points3d_m = None if walk.points3d_m is None else walk.points3d_m[:, c].copy()
    found = np.zeros_like(elsewhere)
    for track in tracks:
        of_track = seen_at(track, starts.own_s(track.camera, walk.time_s))
        is_walker = (elsewhere | ~is_known) & ~found & (radii_away(of_track[0]) <= ELSEWHERE)
        points2d_px[is_walker], confidence[is_walker] = of_track[0][is_walker], of_track[1][is_walker]
        if points3d_m is not None:
            points3d_m[is_walker] = of_track[2][is_walker]
        found |= is_walker
    lost = elsewhere & ~found
    if (found | lost).sum() <= _FEW * len(found) or lost.sum() > 0.5 * (is_known | found).sum():
        return walk
    points2d_px[lost], confidence[lost] = np.nan, 0.0
    if points3d_m is not None:
        points3d_m[lost] = np.nan
    return _replaced(walk, c, points2d_px, confidence, points3d_m)


def offset_px(
    seen_px: Float[np.ndarray, "frame joint 2"], there_px: Float[np.ndarray, "frame joint 2"]
) -> Float[np.ndarray, " frame"]:
    """Median over the joints: no minority of hidden ones makes it somebody else. NaN where too few are known."""
    offset_px = np.linalg.norm(there_px - seen_px, axis=-1)
    n_known = np.isfinite(offset_px).sum(axis=-1)
    ordered = np.sort(offset_px, axis=-1)  # NaN last
    median_px = np.take_along_axis(ordered, (np.maximum(n_known, 1)[:, None] - 1) // 2, axis=-1)[:, 0]
    return np.where(n_known >= MIN_JOINTS, median_px, np.nan)


def _replaced(
    walk: Walk,
    c: int,
    points2d_px: Float[np.ndarray, "frame joint 2"],
    confidence: Float[np.ndarray, "frame joint"],
    points3d_m: Float[np.ndarray, "frame joint 3"] | None,
) -> Walk:
    """What one camera saw."""
    every_px, every_confidence, every_m = walk.points2d_px.copy(), walk.confidence.copy(), walk.points3d_m
    every_px[:, c], every_confidence[:, c] = points2d_px, confidence
    if every_m is not None and points3d_m is not None:
        every_m = every_m.copy()
        every_m[:, c] = points3d_m
    return replace(walk, points2d_px=every_px, confidence=every_confidence, points3d_m=every_m)
