"""The part of a walk that the geometry rests on: frames, joints, and the weight of each detection."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from fgpose.calibration.adjustment.sightings import Sightings
from fgpose.calibration.from_people.body_size import INLIER_SHARE, body_radius
from fgpose.calibration.from_people.walk import Walk
from fgpose.estimation.evidence.weights import LEAST_WEIGHT
from fgpose.estimation.noise import CORRELATION_S, correlated_frames
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.triangulation import triangulate_robust
from fgpose.sampling import spread_evenly, usual_step_s
from fgpose.skeleton import Skeleton
from fgpose_factors.robust_statistics import known_median

# Joints move almost uniformly for so long before and after a frame, and their errors are correlated over longer: wider
# windows follow the swing of a limb less, narrower ones are noisier.
_VELOCITY_S = 0.11
_MAX_JOINTS = 40  # of a skeleton without limbs; time and memory grow with their square


@dataclass(frozen=True, eq=False)
class Evidence:
    """The frames and joints of a walk that are used."""

    frames: Int[np.ndarray, " frame"]
    """Of the walk."""
    joints: Int[np.ndarray, " joint"]
    """Of the skeleton."""
    sightings: Sightings

    def of_skeleton(
        self, joints_m: Float[np.ndarray, "frame joint 3"], skeleton: Skeleton
    ) -> Float[np.ndarray, "frame all 3"]:
        """Our joints in their places among all; NaN = the others."""
        every_m = np.full((len(joints_m), skeleton.n_joints, 3), np.nan)
        every_m[:, self.joints] = joints_m
        return every_m


def evidence_of(walk: Walk, rig: CameraRig, max_frames: int) -> Evidence:
    """What two cameras see at a time, in so many frames at most, spread evenly.

    The errors of a network are correlated in time: where frames are closer than that, each counts less.

    Raises:
        ValueError: no joint is seen by two cameras at a time.
    """
    joints = body_joints(walk.skeleton)
    frames = frames_of_use(walk, joints, max_frames)
    undistorted_px, velocity_pxps = _moving(walk, rig, frames, joints)
    known = np.isfinite(undistorted_px).all(axis=-1)
    known &= known.sum(axis=1, keepdims=True) >= 2
    counted_as_one = float(correlated_frames(usual_step_s(walk.time_s[frames]), CORRELATION_S))
    confidence = np.maximum(walk.confidence[frames][:, :, joints], LEAST_WEIGHT)
    weights = np.where(known, confidence / counted_as_one, 0.0)
    return Evidence(frames, joints, Sightings(undistorted_px, weights, velocity_pxps, np.zeros(rig.n_cameras)))


def body_joints(skeleton: Skeleton) -> Int[np.ndarray, " joint"]:
    """Joints of trunk and limbs and those next to them: faces and fingers add nothing but errors of their own."""
    if not skeleton.limb_pairs:
        return spread_evenly(skeleton.n_joints, _MAX_JOINTS)
    of_limbs = {joint for pair in skeleton.limb_pairs for bone in pair for joint in bone}
    next_to = {other for joint in of_limbs for other in skeleton.neighbours[joint]}
    return np.array(sorted(of_limbs | next_to | set(skeleton.root)))


def frames_of_use(walk: Walk, joints: Int[np.ndarray, " joint"], at_most: int) -> Int[np.ndarray, " frame"]:
    """Frames, spread evenly, in which two cameras see a joint.

    Raises:
        ValueError: there is none.
    """
    seen = walk.seen[:, :, joints]
    useful = np.flatnonzero((seen.sum(axis=1) >= 2).any(axis=1))
    if not useful.size:
        raise ValueError("the cameras cannot be calibrated: no two of them see the walker at the same time")
    return useful[spread_evenly(len(useful), at_most)]


def frames_of(walk: Walk, frames: Int[np.ndarray, " used"]) -> Walk:
    """Some frames of a walk."""
    points3d_m = None if walk.points3d_m is None else walk.points3d_m[frames]
    points2d_px, confidence = walk.points2d_px[frames], walk.confidence[frames]
    return replace(
        walk, time_s=walk.time_s[frames], points2d_px=points2d_px, confidence=confidence, points3d_m=points3d_m
    )


def body_radius_px(points_px: Float[np.ndarray, "frame joint 2"]) -> float:
    """How large the walker is in an image: median over frames; NaN where fewer than two joints are seen."""
    return known_median(body_radius(points_px))


def reconstructed(walk: Walk, rig: CameraRig) -> Float[np.ndarray, "frame joint 3"]:
    """The joints of all frames of a walk, in the gauge of the rig; NaN = not determined."""
    radius_px = float(np.nanmedian([body_radius_px(walk.points2d_px[:, c]) for c in range(rig.n_cameras)]))
    undistorted_px = rig.undistort(walk.points2d_px)
    return triangulate_robust(undistorted_px, walk.confidence, rig, INLIER_SHARE * radius_px).positions_m


def _moving(
    walk: Walk, rig: CameraRig, frames: Int[np.ndarray, " frame"], joints: Int[np.ndarray, " joint"]
) -> tuple[Float[np.ndarray, "frame camera joint 2"], Float[np.ndarray, "frame camera joint 2"]]:
    """Undistorted detections, NaN = missing, and their velocities, px/s: the slope of a line through those around."""
    reach = int(np.ceil(_VELOCITY_S / usual_step_s(walk.time_s)))
    around = np.clip(frames[:, None] + np.arange(-reach, reach + 1), 0, len(walk.time_s) - 1)
    window, place = np.unique(around, return_inverse=True)
    place = place.reshape(around.shape)
    points_px = np.where(walk.seen[window][..., None], walk.points2d_px[window], np.nan)[:, :, joints]
    points_px = rig.undistort(points_px)
    lag_s = walk.time_s[around] - walk.time_s[frames][:, None]
    near = (np.abs(lag_s) <= _VELOCITY_S) & np.append(np.ones((len(frames), 1), bool), np.diff(around) > 0, axis=1)
    return points_px[place[:, reach]], _slopes(points_px[place], np.where(near, lag_s, np.nan))


def _slopes(
    points_px: Float[np.ndarray, "frame lag camera joint 2"], lag_s: Float[np.ndarray, "frame lag"]
) -> Float[np.ndarray, "frame camera joint 2"]:
    """Least squares; zero where fewer than three points are known."""
    lag_s = lag_s[:, :, None, None, None]
    known = np.isfinite(points_px) & np.isfinite(lag_s)
    count = np.maximum(known.sum(axis=1, keepdims=True), 1)
    from_mean_s = np.where(known, lag_s, 0.0)
    from_mean_s = np.where(known, from_mean_s - from_mean_s.sum(axis=1, keepdims=True) / count, 0.0)
    spread_s2 = np.sum(from_mean_s**2, axis=1)
    products = np.sum(from_mean_s * np.where(known, points_px, 0.0), axis=1)
    enough = (known.sum(axis=1) >= 3) & (spread_s2 > 0)
    return np.divide(products, spread_s2, out=np.zeros_like(products), where=enough)
