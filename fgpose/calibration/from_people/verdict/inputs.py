"""What a verdict rests on, gathered from a calibration and the walk that it was made from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from fgpose.calibration.adjustment.unknowns import Groups
from fgpose.calibration.from_people.calibrated import CalibrationFinding, CameraSigmas
from fgpose.calibration.from_people.rig.focal_check import FocalCheck
from fgpose.calibration.from_people.verdict.alignment import aligned
from fgpose.calibration.from_people.verdict.coverage import Coverage, coverage
from fgpose.calibration.from_people.verdict.cross_checks import cross_check_deg, medians_mrad, third_views_mrad
from fgpose.calibration.from_people.verdict.handedness import handedness, mirrored_views
from fgpose.calibration.from_people.verdict.moved_cameras import MovedCamera, MovedMidway, moved_camera, moved_midway
from fgpose.calibration.from_people.verdict.sigmas import disagreement
from fgpose.calibration.from_people.walk import Walk
from fgpose.calibration.from_people.world.anatomy import Anatomy
from fgpose.calibration.from_people.world.metric import Metric
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.intrinsics import is_of_another_size

_MIN_UNUSED = 25  # frames: with fewer the median of what was not used says less than all frames


@dataclass(frozen=True, eq=False)
class VerdictInputs:
    """What a verdict rests on. Numbers of cameras are in the order of camera_names; NaN: not known."""

    camera_names: tuple[str, ...]
    sigmas: CameraSigmas
    distance_m: Float[np.ndarray, " camera"]
    """From the person, median."""
    third_view_mrad: Float[np.ndarray, " camera"]
    """cross_checks.third_views_mrad, of frames that were not used: medians."""
    cross_check_deg: Float[np.ndarray, " camera"]
    """cross_checks.cross_check_deg."""
    halves_deg: Float[np.ndarray, " camera"]
    """By how much the halves of the recording disagree: rotation ..."""
    halves_m: Float[np.ndarray, " camera"]
    """... and position."""
    coverage: Coverage
    estimated_lenses: Groups
    """Cameras whose focal length was estimated, those together that share one."""
    start_certain: Bool[np.ndarray, " camera"]
    mirrored: Bool[np.ndarray, " camera"]
    """handedness.mirrored_views."""
    handedness: float
    """handedness.handedness of the reconstructed joints."""
    upright: float
    """Share of the frames in which the person is upright."""
    camera_tilt_deg: float
    """Angle between the vertical and what is up in the images, the mean of all cameras."""
    duration_s: float
    """For how long two cameras saw the person."""
    of_scale: tuple[CalibrationFinding, ...] = ()
    focal_check: FocalCheck | None = None
    """Of focal lengths that were given; None: not checked."""
    moved: MovedCamera | None = None
    """While it filmed."""
    midway: MovedMidway | None = None
    """Some camera, about the middle of the recording."""
    off_centre: Bool[np.ndarray, " camera"] | None = None
    """Whose K seems to be for images of another size."""


def gather(
    first: Walk,
    walk: Walk,
    metric: Metric,
    sigmas: CameraSigmas,
    halves: tuple[CameraRig, CameraRig] | None,
    unused: Bool[np.ndarray, " frame"],
    estimated_lenses: Groups,
    start_certain: Bool[np.ndarray, " camera"],
    focal_check: FocalCheck | None = None,
) -> VerdictInputs:
    """The inputs on which a calibration is judged.

    Args:
        first: as it was before views of somebody else were left out.
        walk: that the calibration was made from, of the same frames.
        metric: the rig and the joints of the walk in the world.
        sigmas: of the cameras.
        halves: the rigs from the two halves of the recording, in any gauge; None: not halved.
        unused: frames of the walk that the adjustment did not use.
        estimated_lenses: cameras whose focal length was estimated, those together that share one.
        start_certain: whose start is.
        focal_check: of focal lengths that were given.
    """
    rig, joints_m = metric.rig, metric.joints_m
    judged = unused if unused.sum() >= _MIN_UNUSED else np.ones_like(unused)
    halves_deg, halves_m = _halves(halves, rig)
    unknown = np.full(rig.n_cameras, np.nan)
    points3d_m = walk.points3d_m
    third_mrad = third_views_mrad(rig.undistort(walk.points2d_px[judged]), walk.confidence[judged], rig)
    return VerdictInputs(
        camera_names=rig.names,
        sigmas=sigmas,
        distance_m=_distances_m(walk, rig, joints_m),
        third_view_mrad=medians_mrad(third_mrad),
        cross_check_deg=unknown if points3d_m is None else cross_check_deg(points3d_m, joints_m, rig),
        halves_deg=halves_deg,
        halves_m=halves_m,
        coverage=coverage(walk, rig, joints_m),
        estimated_lenses=estimated_lenses,
        start_certain=start_certain,
        mirrored=unknown > 0 if points3d_m is None else mirrored_views(points3d_m, walk.skeleton),
        handedness=handedness(joints_m, walk.skeleton),
        upright=metric.vertical.upright,
        camera_tilt_deg=camera_tilt_deg(rig),
        duration_s=float((walk.shows_walker.sum(axis=1) >= 2).sum()) * walk.step_s,
        of_scale=metric.scale.findings,
        focal_check=focal_check,
        moved=moved_camera(walk.time_s[judged], *_all_shown(first, walk, judged), rig),
        midway=None if halves is None else moved_midway(halves, rig, sigmas),
        off_centre=np.array([is_of_another_size(camera) for camera in rig.cameras]),
    )


def _all_shown(first: Walk, walk: Walk, frames: Bool[np.ndarray, " frame"]) -> tuple[np.ndarray, np.ndarray]:
    """Detections and their confidence in some frames; with views in which somebody was seen, but not where the walker
    is."""
    is_left_out = np.logical_not(np.any(walk.confidence > 0, axis=2))
    points2d_px = np.where(is_left_out[..., None, None], first.points2d_px, walk.points2d_px)
    return points2d_px[frames], np.where(is_left_out[..., None], first.confidence, walk.confidence)[frames]


def _halves(
    halves: tuple[CameraRig, CameraRig] | None, rig: CameraRig
) -> tuple[Float[np.ndarray, " camera"], Float[np.ndarray, " camera"]]:
    """Degrees and metres."""
    if halves is None:
        return np.full(rig.n_cameras, np.nan), np.full(rig.n_cameras, np.nan)
    first, second = (aligned(half, rig)[0].rig(half) for half in halves)
    apart = disagreement(first, second)
    return np.rad2deg(np.sqrt(apart.rotation_rad2)), np.sqrt(apart.position_m2)


def _distances_m(
    walk: Walk, rig: CameraRig, joints_m: Float[np.ndarray, "frame joint 3"]
) -> Float[np.ndarray, " camera"]:
    """Medians over the frames in which the hips are known; NaN without any."""
    hips_m = Anatomy(walk.skeleton).hips_m(joints_m)
    hips_m = hips_m[np.isfinite(hips_m).all(axis=-1)]
    if not len(hips_m):
        return np.full(rig.n_cameras, np.nan)
    return np.array([np.median(np.linalg.norm(hips_m - camera.position_m, axis=-1)) for camera in rig.cameras])


def camera_tilt_deg(rig: CameraRig) -> float:
    """Between the z axis of the world and the mean of what is up in the images."""
    up = -np.mean([camera.world_T_camera[:3, 1] for camera in rig.cameras], axis=0)
    return float(np.rad2deg(np.arctan2(np.linalg.norm(up[:2]), up[2])))
