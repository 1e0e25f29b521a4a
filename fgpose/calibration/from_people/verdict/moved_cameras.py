"""Cameras that were moved, turned or zoomed while a calibration was filmed: what they saw then is outvoted by the rest
of the time, and the rig is right for that alone. About the middle nothing is outvoted, and the rig is right for neither
half."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.calibration.disagreement import MAX_MRAD, disagreement
from fgpose.calibration.from_people.calibrated import CameraSigmas
from fgpose.calibration.from_people.verdict.alignment import aligned
from fgpose.calibration.from_people.verdict.cross_checks import medians_mrad, third_views_mrad
from fgpose.geometry.camera import CameraRig
from fgpose_factors.robust_statistics import known_median

# Of 24 simulated calibrations with cameras that stood still, the worst of eight parts of 20 s has 1.9 times the median
# of the camera, and 16 mrad at most where that is 10; of a camera that was turned by 3 degrees, 10 times.
_PART_S, _FEWEST_PARTS, _TIMES = 2.5, 4, 2.5
# The whole of a recording is half as far from each half as the halves are from each other, where both are as sure.
_FARTHER = 1.5
_MOST_OF_VARIANCE = 0.9  # three times what is not sure anyway


@dataclass(frozen=True)
class MovedCamera:
    """That sees the person elsewhere for a while."""

    camera: int | None
    """None: which one it is, is not clear."""
    from_s: float
    to_s: float
    """By the clock of the walk."""
    mrad: float
    """By how much it, or the worst, is beside where the others see the person then."""
    usual_mrad: float
    """And all the time, median."""


def moved_camera(
    time_s: Float[np.ndarray, " frame"],
    points2d_px: Float[np.ndarray, "frame camera joint 2"],
    confidence: Float[np.ndarray, "frame camera joint"],
    rig: CameraRig,
) -> MovedCamera | None:
    """The camera that sees the person elsewhere in some part of the recording; None: there is none, or it is too short.

    Args:
        time_s: of the frames.
        points2d_px, confidence, rig: of the detections, as for third_views_mrad but in the original images.
    """
    n_parts = int((time_s[-1] - time_s[0]) / _PART_S)
    if n_parts < _FEWEST_PARTS:
        return None
    undistorted_px = rig.undistort(points2d_px)
    third_mrad = third_views_mrad(undistorted_px, confidence, rig)
    part = np.minimum(((time_s - time_s[0]) / _PART_S).astype(int), n_parts - 1)
    of_parts_mrad = np.array([medians_mrad(third_mrad[:, part == each]) for each in range(n_parts)]).T
    usual_mrad = medians_mrad(third_mrad)
    with np.errstate(invalid="ignore"):
        is_off = of_parts_mrad > np.maximum(MAX_MRAD, _TIMES * usual_mrad[:, None])
    if not is_off.any():
        return None
    worst = int(np.argmax(np.nanmax(np.where(is_off, of_parts_mrad, 0.0), axis=1)))
    then = np.isin(part, np.flatnonzero(is_off[worst]))
    camera = _which(undistorted_px[then], confidence[then], rig, third_mrad[:, then])
    shown = worst if camera is None else camera
    when_s, mrad = time_s[then], known_median(third_mrad[shown, then])
    return MovedCamera(camera, float(when_s[0]), float(when_s[-1]), mrad, float(usual_mrad[shown]))


@dataclass(frozen=True)
class MovedMidway:
    """How far the whole recording has the cameras from where each of its halves has them, root mean square."""

    whole_deg: float
    """From the nearer half: rotation ..."""
    whole_m: float
    """... and position."""
    halves_deg: float
    """The halves from each other."""
    halves_m: float


def moved_midway(halves: tuple[CameraRig, CameraRig], rig: CameraRig, sigmas: CameraSigmas) -> MovedMidway | None:
    """Whether some camera was moved about the middle of the recording; None: nothing says so.

    Args:
        halves: the rigs of both halves, in any gauge.
        rig: that of the whole.
        sigmas: of its cameras, with how far it is from the middle of the halves.
    """
    first, second = (aligned(half, rig)[1].reshape(-1, 2, 3) for half in halves)
    whole, apart = np.minimum(_typical(first), _typical(second)), _typical(first - second)
    sigma = np.stack([np.deg2rad(sigmas.direction_deg), sigmas.position_m], axis=1)
    is_sure = np.sum((first + second) ** 2, axis=-1) / 4 > _MOST_OF_VARIANCE * sigma**2
    if not ((whole > _FARTHER * apart) & is_sure.any(axis=0)).any():
        return None
    return MovedMidway(np.rad2deg(whole[0]), float(whole[1]), np.rad2deg(apart[0]), float(apart[1]))


def _typical(errors: Float[np.ndarray, "camera 2 3"]) -> Float[np.ndarray, " 2"]:
    """Root mean square over the cameras: of rotations (radians), and of positions."""
    return np.sqrt(np.mean(np.sum(errors**2, axis=-1), axis=0))


def _which(
    undistorted_px: Float[np.ndarray, "frame camera joint 2"],
    confidence: Float[np.ndarray, "frame camera joint"],
    rig: CameraRig,
    third_mrad: Float[np.ndarray, "camera frame"],
) -> int | None:
    """The camera without which the others agree, in these frames."""
    n_cameras = rig.n_cameras
    if n_cameras < 3:
        return None
    without_mrad = np.full((n_cameras, n_cameras), np.nan)
    for left_out in range(n_cameras):
        others = [c for c in range(n_cameras) if c != left_out]
        pair = undistorted_px[:, others], confidence[:, others], rig.subset([rig.names[c] for c in others])
        without_mrad[left_out, others] = medians_mrad(third_views_mrad(*pair))
    found = disagreement(medians_mrad(third_mrad), without_mrad)
    return None if found is None else found.camera
