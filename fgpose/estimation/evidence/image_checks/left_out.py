"""Detections that were left out, as a result shows them: of no joint, and as far off as they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from fgpose.estimation.evidence.delays import on_time_px
from fgpose.estimation.evidence.gather import FRAMES_AT_ONCE
from fgpose.freed_memory import hand_back
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.vectors import norm
from fgpose.observations import Observations
from fgpose.sampling import parts_of
from fgpose.trajectory import Estimate, Trajectory


def with_left_out(
    trajectory: Trajectory, given: Observations, rig: CameraRig, of_other_side: Bool[np.ndarray, "frame camera joint"]
) -> Trajectory:
    """What was estimated from these observations, with visibility and residuals of the detections that were left out or
    taken for those of the other side, where their joint is known."""
    if trajectory.visibility is None or trajectory.residual_px is None:
        return trajectory
    known = np.asarray(np.isfinite(trajectory.positions_m).all(axis=-1))
    left_out = given.seen & (np.isnan(trajectory.visibility) | of_other_side) & known[:, None]
    if not (left_out.any() or of_other_side.any()):
        return trajectory
    hand_back()
    visibility, residual_px = trajectory.visibility.copy(), trajectory.residual_px
    visibility[of_other_side] = np.nan
    visibility[left_out] = 0.0
    # One after the other: of an hour each takes 60 MB, and nobody else may have those that were.
    trajectory = replace(trajectory, visibility=visibility)
    residual_px = residual_px.copy()
    residual_px[of_other_side] = np.nan
    for part in parts_of(trajectory.n_frames, FRAMES_AT_ONCE):
        own = left_out[part]
        if own.any():
            positions_m = trajectory.positions_m[part]
            off_px = rig.project(positions_m) - on_time_px(given.frames(part), rig, positions_m)
            residual_px[part][own] = norm(off_px)[own]
    return replace(trajectory, residual_px=residual_px)


def left_out_px(given: Observations, used: Observations) -> Float[np.ndarray, "frame camera joint 2"]:
    """The detections, in pixels of the original images, of which nothing is used, or as those of the other side; NaN
    where there is none."""
    is_used = np.asarray((given.points2d_px == used.points2d_px).all(axis=-1))
    return np.where((given.seen & ~is_used)[..., None], given.points2d_px, np.nan)


def showing_left_out(newest: Estimate, left_out_px: Float[np.ndarray, "camera joint 2"], rig: CameraRig) -> Estimate:
    """The same as with_left_out, of the newest frame and what was left out of it (left_out_px)."""
    if newest.visibility is None or newest.residual_px is None or not np.isfinite(left_out_px).any():
        return newest
    off_px = norm(rig.project(newest.positions_m) - rig.undistort(left_out_px))
    left_out = np.isfinite(off_px)
    visibility = np.where(left_out, 0.0, newest.visibility)
    return replace(newest, visibility=visibility, residual_px=np.where(left_out, off_px, newest.residual_px))
