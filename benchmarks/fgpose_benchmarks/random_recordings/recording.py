"""A random recording, put together."""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Iterator

import numpy as np
from jaxtyping import Float

from fgpose.geometry.camera import CameraRig
from fgpose.io.skeletons import load_skeleton
from fgpose.observations import Observations
from fgpose_benchmarks.comparison.recording import BenchmarkRecording
from fgpose_benchmarks.random_recordings.conditions import Conditions, draw
from fgpose_benchmarks.random_recordings.errors import Detections, TrueViews, detections
from fgpose_benchmarks.random_recordings.scene import believed_rig, lateness_s, motion_m, moved_m, true_rig
from fgpose_benchmarks.synthetic.noise import correlated_normal

VERSION = 1
"""Results of one version can be compared. Whatever changes a recording is a new version."""

VARIANT = "random"
LEAST_TOLD = 0.1
_MEDIAN_OVER_SIGMA = 0.6745  # of the absolute value of a normal distribution
_DEPTH_S = 0.3
_TURNED_BACK_PX = 1.0
_OWN_LATERAL = 1.5  # of "of their own": over the error of 2D, which it does not share


def recordings(seeds: Iterable[int]) -> Iterator[BenchmarkRecording]:
    """One recording for each seed, named after it; the same at each call. Left out are those in which two cameras are
    right about hardly any joint: nobody could tell anything.

    Raises:
        ValueError: a seed is negative.
    """
    return (recording for recording in (record(draw(seed)) for seed in seeds) if share_told(recording) >= LEAST_TOLD)


def share_told(recording: BenchmarkRecording) -> float:
    """Of the joints in all frames, how many two cameras are right about."""
    assert recording.oracle_observations is not None
    return float(np.mean(recording.oracle_observations.seen.sum(axis=1) >= 2))


def record(conditions: Conditions) -> BenchmarkRecording:
    """A recording under these conditions. The oracle gets the right detections, the true cameras and clocks."""
    skeleton = load_skeleton("h36m_17")
    truth_m = motion_m(conditions)
    rig = true_rig(conditions, _rng(conditions, "rig"))
    believed = believed_rig(rig, conditions, _rng(conditions, "calibration"))
    late_s = lateness_s(conditions, rig.n_cameras, _rng(conditions, "late"))
    time_s = np.arange(len(truth_m)) / conditions.fps

    def seen(late_s: Float[np.ndarray, " camera"]) -> tuple[Detections, TrueViews, Observations]:
        each_m = np.stack([moved_m(conditions, time_s + late) for late in late_s], axis=1)
        views = _views(each_m, rig)
        found = detections(views, skeleton, conditions, _rng(conditions, "detector"))
        points3d_m = _views3d_m(each_m, found, believed, conditions, _rng(conditions, "3D"))
        return (
            found,
            views,
            Observations(skeleton, time_s, found.points_px, found.confidence, points3d_m, camera_names=rig.names),
        )

    found, _, observations = seen(late_s)
    on_time, views, exact = seen(np.zeros(rig.n_cameras))
    size_px = np.array(conditions.size_px)
    outside = ((views.points_px < 0) | (views.points_px >= size_px)).any(axis=-1)
    right = exact.without(on_time.wrong | outside)
    error_px = rig.undistort(right.points2d_px) - rig.project(truth_m)
    return BenchmarkRecording(
        clip=f"{conditions.seed:04d}",
        variant=VARIANT,
        observations=observations,
        rig=believed,
        fps=conditions.fps,
        truth_m=truth_m,
        occluded=found.hidden,
        true_rig=rig,
        true_offsets_s=late_s,
        oracle_observations=Observations(skeleton, time_s, right.points2d_px, right.confidence, camera_names=rig.names),
        sigma_px=float(np.nanmedian(np.abs(error_px)) / _MEDIAN_OVER_SIGMA) if right.seen.any() else None,
    )


def _rng(conditions: Conditions, what: str) -> np.random.Generator:
    # hash() of a string differs from process to process.
    return np.random.default_rng((conditions.seed, zlib.crc32(what.encode())))


def _views(each_m: Float[np.ndarray, "frame camera joint 3"], rig: CameraRig) -> TrueViews:
    depth_m = np.stack([camera.to_camera_frame(each_m[:, c])[..., 2] for c, camera in enumerate(rig.cameras)], axis=1)
    focal_px = np.array([camera.K[0, 0] for camera in rig.cameras])
    undistorted_px = rig.project_each(each_m)
    points_px = np.stack([camera.distort(undistorted_px[:, c]) for c, camera in enumerate(rig.cameras)], axis=1)
    # Far outside the image the polynomial of a lens turns back.
    turned_back = np.abs(rig.undistort(points_px) - undistorted_px).max(axis=-1) > _TURNED_BACK_PX
    return TrueViews(np.where(turned_back[..., None], np.nan, points_px), focal_px[:, None] / depth_m, depth_m)


def _views3d_m(
    each_m: Float[np.ndarray, "frame camera joint 3"],
    found: Detections,
    rig: CameraRig,
    conditions: Conditions,
    rng: np.random.Generator,
) -> Float[np.ndarray, "frame camera joint 3"] | None:
    """Absolute 3D joints of a monocular network, placed by the rig as it is believed to be. Depths are wrong by what
    all joints share and by what each has; larger people are farther away."""
    if conditions.views3d == "none":
        return None
    n_frames, n_cameras, n_joints = found.hidden.shape

    def slow_m(n_values: int) -> Float[np.ndarray, "frame camera value"]:
        return conditions.depth_m * correlated_normal(rng, (n_frames, n_cameras, n_values), conditions.fps, _DEPTH_S)

    farther = 1 + conditions.stature_share * rng.standard_normal((1, n_cameras, 1))
    distance_m = np.linalg.norm(each_m - rig.positions_m[:, None], axis=-1)
    distance_m = farther * distance_m + slow_m(1) + slow_m(n_joints)
    undistorted_px = rig.undistort(found.points_px)
    ray = np.stack([camera.ray(undistorted_px[:, c]) for c, camera in enumerate(rig.cameras)], axis=1)
    points_m = rig.positions_m[:, None] + distance_m[..., None] * ray
    if conditions.views3d == "of their own":
        lateral = correlated_normal(rng, points_m.shape, conditions.fps, _DEPTH_S)
        points_m = points_m + _OWN_LATERAL * conditions.sigma_m * lateral
    return points_m
