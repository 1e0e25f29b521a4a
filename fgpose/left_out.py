"""One camera against the robust triangulation of all the others: in space, in time, left against right."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from fgpose.camera import CameraRig
from fgpose.triangulation import triangulate_robust

_MAX_SHIFT_FRAMES = 5
_STRETCHES = 8
_STRETCH_FRAMES = 250
# Fewer errors than this have no median worth comparing.
_MIN_ERRORS = 20


@dataclass(frozen=True)
class Shift:
    """By how many frames a camera is late, and the share of its error that reading it so much later takes away."""

    frames: float
    gain: float


@dataclass(frozen=True, eq=False)
class LeftOut:
    """The detections of one camera and where the other cameras expect them; NaN where either is missing."""

    detected_px: Float[np.ndarray, "frame joint 2"]
    expected_px: Float[np.ndarray, "frame joint 2"]

    @cached_property
    def offset_px(self) -> Float[np.ndarray, 2]:
        """Median difference: what a wrong principal point or a slightly turned camera leaves; NaN without any."""
        return _median_vector(self.detected_px - self.expected_px)

    def error_px(self, shift: int = 0, *, remove_offset: bool = False) -> float:
        """Median distance when the camera is read this many frames later; NaN without enough to go by."""
        detected = self.detected_px[max(0, shift) : len(self.detected_px) + min(0, shift)]
        expected = self.expected_px[max(0, -shift) : len(self.expected_px) + min(0, -shift)]
        difference_px = detected - expected
        if remove_offset:
            difference_px = difference_px - _median_vector(difference_px)
        error_px = np.linalg.norm(difference_px, axis=-1)
        known = error_px[np.isfinite(error_px)]
        return float(np.median(known)) if known.size >= _MIN_ERRORS else np.nan

    def best_shift(self, *, remove_offset: bool = True) -> Shift:
        """The shift with the least error, to a fraction of a frame (a parabola through the least three)."""
        shifts = range(-_MAX_SHIFT_FRAMES, _MAX_SHIFT_FRAMES + 1)
        errors_px = np.array([self.error_px(shift, remove_offset=remove_offset) for shift in shifts])
        if np.isnan(errors_px).any():
            return Shift(np.nan, np.nan)
        best = int(np.argmin(errors_px))
        gain = 1.0 - errors_px[best] / max(errors_px[_MAX_SHIFT_FRAMES], 1e-9)
        return Shift(shifts[best] + _vertex(errors_px, best), float(gain))


def _median_vector(difference_px: Float[np.ndarray, "frame joint 2"]) -> Float[np.ndarray, 2]:
    known = difference_px[np.isfinite(difference_px).all(axis=-1)]
    return np.median(known, axis=0) if len(known) else np.full(2, np.nan)


def _vertex(values: Float[np.ndarray, " shift"], best: int) -> float:
    """Where the parabola through the least value and its neighbours is least, relative to it; 0 at the ends."""
    if best in (0, len(values) - 1):
        return 0.0
    before, at, after = values[best - 1 : best + 2]
    curvature = before - 2 * at + after
    return float(0.5 * (before - after) / curvature) if curvature > 0 else 0.0


def compare_with_others(
    undistorted_px: Float[np.ndarray, "frame camera joint 2"],
    confidence: Float[np.ndarray, "frame camera joint"],
    rig: CameraRig,
    inlier_px: float,
) -> tuple[LeftOut, ...]:
    """Every camera against all others; nothing is expected where there are fewer than two others."""
    views = []
    for c, camera in enumerate(rig.cameras):
        others = [other for other in range(rig.n_cameras) if other != c]
        expected_px = np.full_like(undistorted_px[:, c], np.nan)
        if len(others) >= 2:
            rest = rig.subset(rig.names[other] for other in others)
            triangulation = triangulate_robust(undistorted_px[:, others], confidence[:, others], rest, inlier_px)
            expected_px = camera.project(triangulation.positions_m)
        views.append(LeftOut(undistorted_px[:, c], expected_px))
    return tuple(views)


def sample_stretches(
    undistorted_px: Float[np.ndarray, "frame camera joint 2"], confidence: Float[np.ndarray, "frame camera joint"]
) -> tuple[Float[np.ndarray, "sample camera joint 2"], Float[np.ndarray, "sample camera joint"]]:
    """A long recording cut down to stretches spread evenly over it, empty frames between them so that no shift in
    time reaches from one into the next; a short one as it is."""
    n_frames = len(undistorted_px)
    if n_frames <= _STRETCHES * _STRETCH_FRAMES:
        return undistorted_px, confidence
    starts = np.linspace(0, n_frames - _STRETCH_FRAMES, _STRETCHES).astype(int)
    points, levels = [], []
    for start in starts.tolist():
        stretch = slice(start, start + _STRETCH_FRAMES)
        points += [undistorted_px[stretch], np.full_like(undistorted_px[:_MAX_SHIFT_FRAMES], np.nan)]
        levels += [confidence[stretch], np.zeros_like(confidence[:_MAX_SHIFT_FRAMES])]
    return np.concatenate(points), np.concatenate(levels)


def shifted(
    undistorted_px: Float[np.ndarray, "frame camera joint 2"],
    confidence: Float[np.ndarray, "frame camera joint"],
    camera: int,
    frames: int,
) -> tuple[Float[np.ndarray, "frame camera joint 2"], Float[np.ndarray, "frame camera joint"]]:
    """The recording with one camera read so many frames later; nothing is seen where that is beyond its ends."""
    points_px, level = undistorted_px.copy(), confidence.copy()
    points_px[:, camera], level[:, camera] = np.nan, 0.0
    n_frames = len(points_px)
    target = slice(max(0, -frames), n_frames + min(0, -frames))
    source = slice(max(0, frames), n_frames + min(0, frames))
    points_px[target, camera], level[target, camera] = undistorted_px[source, camera], confidence[source, camera]
    return points_px, level
