"""A report on a recording before anything is solved: what is seen, and what is probably wrong.

Every check compares one camera with the robust triangulation of the others, so that a wrong camera does not hide its
own error. Three cameras are needed for any check, four to find the wrong one. camera_faults finds cameras that are late
or slightly moved.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from fgpose.assessment.leave_one_out import HeldOutView, compare_with_others
from fgpose.assessment.metrics import mean_known
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.triangulation import triangulate_robust
from fgpose.observations import Observations
from fgpose.sampling import frames_per_second, spread_evenly
from fgpose_factors.robust_statistics import known_quantile

# See CameraRig.in_own_px. At 20, as the estimator has it, one of eight turned cameras of real recordings is taken for
# its neighbour.
_INLIER_PX = 14.0
_MAX_FRAMES = 2000  # bounds the time; the medians need no more
# A camera turned by 5 degrees is off by ten times as much as real cameras are; its neighbours by up to twice, since it
# takes part in their comparison.
_CALIBRATION_RATIO = 2.5
# Below this, detections rather than the calibration may cause the difference. Lower, good rigs are reported too. Pixels
# are those of CameraRig.in_own_px.
_MIN_CALIBRATION_PX = 20.0
# Clearly swapped: the swapped labels fit at least twice as well, and the two joints lie well apart in the image.
_SWAP_RATIO = 0.5
_MIN_SWAP_SEPARATION_PX = 30.0
# Share of the pairs. Lower, single errors of a good detector are reported; higher, rare swaps are not.
_SUSPECT_SWAPS = 0.02
# Diagonal of the box around a person and distance of the cameras: wide enough for a child and a hall, narrow enough
# to notice a factor of 1000 in the unit.
_PERSON_M = (0.3, 3.0)
_DISTANCE_M = (0.3, 50.0)


@dataclass(frozen=True)
class CameraInfo:
    """One camera. NaN: cannot be computed."""

    name: str
    share_seen: float
    """Share of all joints and frames in which it detected the joint."""
    confidence: float
    """Median over its detections."""
    residual_px: float
    """Median reprojection error of the robust triangulation of all cameras, undistorted pixels."""
    residual_q90_px: float
    """Its 90 % quantile."""
    left_out_px: float
    """Median distance to the robust triangulation of the other cameras."""
    constant_px: float
    """Part of it that is constant over joints and frames."""
    share_swapped: float
    """Share of its left/right pairs that would fit clearly better with left and right exchanged."""
    distance_m: float
    """Median distance from the person."""


@dataclass(frozen=True)
class Gap:
    """An interval in which fewer than two cameras see a joint."""

    joint: str
    start_s: float
    duration_s: float


@dataclass(frozen=True)
class RecordingInfo:
    """The report on a recording."""

    n_frames: int
    duration_s: float
    fps: float
    """Frames per second over the whole recording, without gaps; NaN for a single frame."""
    skeleton: str
    n_joints: int
    has_points3d: bool
    """Whether the views have 3D joints of their own."""
    cameras: tuple[CameraInfo, ...]
    joint_frames_by_views: tuple[int, ...]
    """How many joints in how many frames are seen by exactly 0, 1, 2, ... cameras."""
    gaps: tuple[Gap, ...]
    never_seen: tuple[str, ...]
    """Joints that two cameras never see at once."""
    suspected_calibration: str | None
    """Camera whose calibration is probably wrong."""
    suspected_swaps: tuple[str, ...]
    """Cameras that exchange left and right in some frames."""
    implausible: tuple[str, ...]
    """Lengths that are implausible as metres, in words."""

    @property
    def suspicious(self) -> bool:
        """Whether anything should be checked before the recording is solved; gaps do not count."""
        return bool(self.suspected_calibration or self.suspected_swaps or self.implausible)


def recording_info(observations: Observations, rig: CameraRig, min_gap_s: float = 0.5) -> RecordingInfo:
    """Report on a recording.

    Residuals and swaps of a long recording come from frames spread evenly over it.

    Args:
        observations: the recording.
        rig: its cameras.
        min_gap_s: shorter gaps are not listed, seconds.

    Raises:
        ValueError: the cameras of the observations and of the rig differ.
    """
    observations.check_cameras(rig.names)
    sampled = spread_evenly(observations.n_frames, _MAX_FRAMES)
    undistorted_px, confidence = rig.undistort(observations.points2d_px[sampled]), observations.confidence[sampled]
    positions_m = triangulate_robust(undistorted_px, confidence, rig, rig.in_own_px(_INLIER_PX)).positions_m
    residual_px = np.linalg.norm(rig.project(positions_m) - undistorted_px, axis=-1)
    views = compare_with_others(undistorted_px, confidence, rig, _INLIER_PX)
    cameras = tuple(
        _camera_info(observations, rig, c, residual_px[:, c], views[c], positions_m) for c in range(rig.n_cameras)
    )
    n_seen = observations.seen.sum(axis=1)
    return RecordingInfo(
        n_frames=observations.n_frames,
        duration_s=float(observations.frame_time_s[-1] - observations.frame_time_s[0]),
        fps=frames_per_second(observations.frame_time_s),
        skeleton=observations.skeleton.name,
        n_joints=observations.skeleton.n_joints,
        has_points3d=observations.points3d_m is not None,
        cameras=cameras,
        joint_frames_by_views=tuple(int(np.sum(n_seen == views)) for views in range(rig.n_cameras + 1)),
        gaps=_gaps(observations, np.asarray(n_seen >= 2), min_gap_s),
        never_seen=tuple(np.array(observations.skeleton.joints)[~np.any(n_seen >= 2, axis=0)].tolist()),
        suspected_calibration=_suspected_calibration(cameras, rig),
        suspected_swaps=tuple(camera.name for camera in cameras if camera.share_swapped > _SUSPECT_SWAPS),
        implausible=_implausible(cameras, _person_size_m(positions_m)),
    )


def _camera_info(
    observations: Observations,
    rig: CameraRig,
    c: int,
    residual_px: Float[np.ndarray, "frame joint"],
    left_out: HeldOutView,
    positions_m: Float[np.ndarray, "frame joint 3"],
) -> CameraInfo:
    seen = observations.seen[:, c]
    least_apart_px = float(rig.in_own_px(_MIN_SWAP_SEPARATION_PX)[c, 0])
    return CameraInfo(
        name=rig.names[c],
        share_seen=float(seen.mean()),
        confidence=known_quantile(np.where(seen, observations.confidence[:, c], np.nan), 0.5),
        residual_px=known_quantile(residual_px, 0.5),
        residual_q90_px=known_quantile(residual_px, 0.9),
        left_out_px=left_out.error_px(),
        constant_px=float(np.linalg.norm(left_out.constant_px)),
        share_swapped=_share_swapped(left_out, observations.skeleton.left_right, least_apart_px),
        distance_m=known_quantile(np.linalg.norm(positions_m - rig.cameras[c].position_m, axis=-1), 0.5),
    )


def _suspected_calibration(cameras: tuple[CameraInfo, ...], rig: CameraRig) -> str | None:
    """The worst camera, if it is much worse than the others are."""
    known = [camera for camera in cameras if np.isfinite(camera.left_out_px)]
    if len(known) < 3:
        return None
    worst = max(known, key=lambda camera: camera.left_out_px)
    others_px = np.median([camera.left_out_px for camera in known if camera is not worst])
    least_px = float(rig.in_own_px(_MIN_CALIBRATION_PX)[cameras.index(worst), 0])
    clear = worst.left_out_px > max(_CALIBRATION_RATIO * others_px, least_px)
    return worst.name if clear else None


def _share_swapped(left_out: HeldOutView, left_right: tuple[tuple[int, int], ...], least_apart_px: float) -> float:
    """Of the left/right pairs that lie apart in the image, those that fit better when exchanged."""
    left, right = np.array(left_right, dtype=int).reshape(-1, 2).T
    expected, detected = left_out.expected_px, left_out.detected_px

    def distance(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.linalg.norm(expected[:, a] - detected[:, b], axis=-1)

    direct, exchanged = distance(left, left) + distance(right, right), distance(left, right) + distance(right, left)
    apart = np.linalg.norm(expected[:, left] - expected[:, right], axis=-1) > least_apart_px
    judged = apart & np.isfinite(direct)
    return float(mean_known(np.where(judged, exchanged < _SWAP_RATIO * direct, np.nan)))


def _gaps(observations: Observations, seen_twice: Bool[np.ndarray, "frame joint"], min_gap_s: float) -> tuple[Gap, ...]:
    """The longest first; from the last frame in which the joint was seen to the next one."""
    time_s = observations.frame_time_s
    gaps = []
    for joint, name in enumerate(observations.skeleton.joints):
        seen = np.flatnonzero(seen_twice[:, joint])
        if seen.size == 0:
            continue
        edges = np.unique([0, *seen.tolist(), len(time_s) - 1])
        durations_s = np.diff(time_s[edges])
        adjacent = np.diff(edges) == 1
        for gap in np.flatnonzero((durations_s > min_gap_s) & ~adjacent).tolist():
            gaps.append(Gap(name, float(time_s[edges[gap]]), float(durations_s[gap])))
    return tuple(sorted(gaps, key=lambda gap: -gap.duration_s))


def _person_size_m(positions_m: Float[np.ndarray, "frame joint 3"]) -> float:
    """Median diagonal of the box around the person."""
    known = np.isfinite(positions_m)
    low = np.where(known, positions_m, np.inf).min(axis=1)
    high = np.where(known, positions_m, -np.inf).max(axis=1)
    return known_quantile(np.linalg.norm(high - low, axis=-1), 0.5)


def _implausible(cameras: tuple[CameraInfo, ...], size_m: float) -> tuple[str, ...]:
    remarks = []
    if size_m < _PERSON_M[0] or size_m > _PERSON_M[1]:
        remarks.append(f"the person is {size_m:.3g} m large")
    for camera in cameras:
        if camera.distance_m < _DISTANCE_M[0] or camera.distance_m > _DISTANCE_M[1]:
            remarks.append(f"camera {camera.name} is {camera.distance_m:.3g} m from the person")
    return tuple(remarks)
