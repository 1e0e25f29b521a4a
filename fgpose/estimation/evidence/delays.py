"""Unsynchronised cameras: each image is compared with the pose at the time when the image was taken.

The detections are corrected, not the factors: a detection is shifted by the distance that the image of the estimated
motion moves between the camera's time and that of the frame. So the factors stay native and robust. The motion between
the two times is the estimate itself, a spline, so that delays of several frames are allowed. The estimate changes
little from one round to the next: two rounds are enough.

The time of a frame is the mean time at which its images were taken. Were all later than that, each round would carry on
the motion that the round before carried on, which diverges.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from fgpose.association.common_clock import are_far_apart, on_common_clock, single_images_together
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.changing_rig import refuse_changing
from fgpose.observations import Observations
from fgpose.sampling import usual_step_s

_ROUNDING_S = 1e-9
"""The mean of equal times differs from them by rounding."""


# The motion carries the images of a camera so far to the time of a frame. On a dance, 0.075 s of one of four cameras
# cost nothing, 0.11 s half of the error more (19 mm instead of 12), and 0.15 s of all four diverge.
_CARRIED_ON_S = 0.1


def of_one_moment(observations: Observations, rig: CameraRig) -> tuple[Observations, CameraRig]:
    """The same by the mean clock of the cameras; where one of them is far from it, images of most frames were taken far
    apart, or most frames are one image, the images that were taken together make other frames (on_common_clock).

    Raises:
        ValueError: the cameras differ, or a clock or a pose changes.
    """
    observations.check_cameras(rig.names)
    refuse_changing(rig)
    observations, rig = by_mean_clock(observations, rig)
    step_s = usual_step_s(observations.frame_time_s)
    if np.abs(rig.time_offsets_s).max() > _CARRIED_ON_S or are_far_apart(observations, step_s):
        return on_common_clock(observations, rig)
    return single_images_together(observations, rig) or (observations, rig)


def by_mean_clock(observations: Observations, rig: CameraRig) -> tuple[Observations, CameraRig]:
    """The same, with the common offset of the cameras in the times of the frames."""
    if not rig.common_offset_s:
        return observations, rig
    return replace(observations, time_s=observations.time_s + rig.common_offset_s), rig.without_common_offset()


def delays_s(observations: Observations, rig: CameraRig) -> Float[np.ndarray, "frame camera"]:
    """How much later than the time of its frame each image was taken: by the time stamps of the cameras, plus the
    time offsets of the rig."""
    late_s = np.broadcast_to(rig.time_offsets_s, (observations.n_frames, observations.n_cameras))
    if observations.time_s.ndim == 2:
        late_s = late_s + np.nan_to_num(observations.time_s - observations.frame_time_s[:, None])
    return np.where(np.abs(late_s) > _ROUNDING_S, late_s, 0.0)


def on_time_px(
    observations: Observations, rig: CameraRig, positions_m: Float[np.ndarray, "frame joint 3"]
) -> Float[np.ndarray, "frame camera joint 2"]:
    """The detections, undistorted, where they would be if all cameras were synchronous and this were the motion,
    estimated from them."""
    observations, rig = by_mean_clock(observations, rig)
    delay_s = delays_s(observations, rig)
    moved_px = image_motion_px(positions_m, observations.frame_time_s, delay_s, rig)
    return rig.undistort(observations.points2d_px) - moved_px


def image_motion_px(
    positions_m: Float[np.ndarray, "frame joint 3"],
    time_s: Float[np.ndarray, " frame"],
    delay_s: Float[np.ndarray, "frame camera"],
    rig: CameraRig,
) -> Float[np.ndarray, "frame camera joint 2"]:
    """How far the image of each joint moves from the time of its frame to that of each camera's image, undistorted
    pixels; zero where the motion is not known."""
    return image_shift_px(positions_m, motion_m(positions_m, time_s, delay_s), rig)


def motion_m(
    positions_m: Float[np.ndarray, "frame joint 3"],
    time_s: Float[np.ndarray, " frame"],
    delay_s: Float[np.ndarray, "frame camera"],
) -> Float[np.ndarray, "frame camera joint 3"]:
    """How far each joint moves from the time of its frame to that of each camera's image; zero where not known."""
    moved_m = np.zeros((*delay_s.shape, *positions_m.shape[1:]))
    for c in np.flatnonzero(delay_s.any(axis=0)).tolist():
        moved_m[:, c] = np.nan_to_num(_at(time_s + delay_s[:, c], positions_m, time_s) - positions_m)
    return moved_m


def image_shift_px(
    positions_m: Float[np.ndarray, "*frames joint 3"],
    moved_m: Float[np.ndarray, "*frames camera joint 3"],
    rig: CameraRig,
) -> Float[np.ndarray, "*frames camera joint 2"]:
    """How far the image of each joint moves in each camera when the joint moves; zero where not known."""
    if not moved_m.any():
        return np.zeros((*moved_m.shape[:-1], 2))
    moved_px = rig.project_each(positions_m[..., None, :, :] + moved_m) - rig.project(positions_m)
    return np.nan_to_num(moved_px)


def _at(
    at_s: Float[np.ndarray, " frame"], positions_m: Float[np.ndarray, "frame joint 3"], time_s: np.ndarray
) -> Float[np.ndarray, "frame joint 3"]:
    """The motion at other times: a spline through the known positions, straight beyond its ends."""
    from scipy.interpolate import CubicSpline

    moved_m = np.full(positions_m.shape, np.nan)
    known = np.asarray(np.isfinite(positions_m).all(axis=-1))
    for joint in np.flatnonzero(known.sum(axis=0) > 1).tolist():
        known_s = time_s[known[:, joint]]
        motion = CubicSpline(known_s, positions_m[known[:, joint], joint])
        within_s = np.clip(at_s, known_s[0], known_s[-1])
        moved_m[:, joint] = motion(within_s) + (at_s - within_s)[:, None] * motion(within_s, 1)
    return moved_m
