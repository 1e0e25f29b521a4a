"""Refining the poses of the cameras on the recording itself: bundle adjustment with the calibration as prior."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from jaxtyping import Float

from fgpose.config import Config
from fgpose.estimation.delays import delays_s, on_time_px
from fgpose.estimation.keys import position_key
from fgpose.estimation.smoother import smooth
from fgpose.geometry.camera import Camera, CameraRig
from fgpose.geometry.triangulation import triangulate_robust
from fgpose.observations import Observations
from fgpose_factors import noise_model

# A camera that is off by a degree moves its detections by 20 to 30 px: with the usual threshold it would never be among
# the views that agree, and nothing could be learned about it.
_INLIER_FACTOR = 2.5
# One camera that was bumped shall move by itself. With Gaussian priors it is cheaper for all of them to share the move,
# which shifts the world: 25 mm instead of 12 mm on simulated recordings with one camera turned by 1 degree.
_BUMPED_SIGMAS = 1.0
_NOTHING_TO_LEARN_FROM = "the calibration cannot be refined: no joint is seen by two cameras that agree"


@dataclass(frozen=True, eq=False)
class RigRefinement:
    """A rig whose cameras agree better, and how far each was moved."""

    rig: CameraRig
    observations: Observations
    """The observations, their per-view 3D moved with the cameras that saw it."""
    rotation_deg: Float[np.ndarray, " camera"]
    translation_m: Float[np.ndarray, " camera"]
    residual_before_px: Float[np.ndarray, " camera"]
    """Median reprojection error of the triangulated joints, with the rig as it was and as it is now."""
    residual_after_px: Float[np.ndarray, " camera"]


def refine_rig(observations: Observations, rig: CameraRig, config: Config | None = None) -> RigRefinement:
    """Move the cameras, as little as needed, so that they agree on the person.

    Poses of the cameras and joints of up to calibration.max_frames frames are variables; the calibration is the prior,
    robust, for most cameras were not touched (GTSAM's GenericProjectionFactor with the projection config's robust
    kernel). Delays that the rig or the time stamps tell are undone first. Where the joints are as a whole is then known
    only as well as the calibration was: a common shift of a few centimetres cannot be told from the images. The errors
    of a detector are alike from frame to frame, so the detections of a camera together count as
    calibration.independent_looks measurements, not as thousands.

    Raises:
        ValueError: the cameras of observations and rig differ, or no joint is seen by two cameras.
    """
    config = config or Config()
    observations.check_cameras(rig.names)
    useful = np.flatnonzero((observations.seen.sum(axis=1) >= 2).any(axis=1))
    if not useful.size:
        raise ValueError(_NOTHING_TO_LEARN_FROM)
    count = min(config.calibration.max_frames, len(useful))
    frames = useful[np.linspace(0, len(useful) - 1, count).astype(int)]
    undistorted_px = _on_time_px(observations, rig, config)[frames]
    confidence = observations.confidence[frames]
    refined = CameraRig(
        tuple(
            replace(camera, world_T_camera=pose.matrix())
            for camera, pose in zip(rig.cameras, _bundle_adjusted(undistorted_px, confidence, rig, config), strict=True)
        )
    )
    moves = [
        gtsam.Pose3(before.world_T_camera).between(gtsam.Pose3(after.world_T_camera))
        for before, after in zip(rig.cameras, refined.cameras, strict=True)
    ]
    return RigRefinement(
        rig=refined,
        observations=moved_with_cameras(observations, rig, refined),
        rotation_deg=np.array([np.rad2deg(np.linalg.norm(gtsam.Rot3.Logmap(move.rotation()))) for move in moves]),
        translation_m=np.array([np.linalg.norm(move.translation()) for move in moves]),
        residual_before_px=_residual_px(undistorted_px, confidence, rig, config),
        residual_after_px=_residual_px(undistorted_px, confidence, refined, config),
    )


def _on_time_px(
    observations: Observations, rig: CameraRig, config: Config
) -> Float[np.ndarray, "frame camera joint 2"]:
    """The detections of all frames, undistorted; the motion is only estimated where there are delays to be undone."""
    if not delays_s(observations, rig).any():
        return rig.undistort(observations.points2d_px)
    return on_time_px(observations, rig, smooth(observations, rig, config).positions_m)


def _bundle_adjusted(
    undistorted_px: Float[np.ndarray, "frame camera joint 2"],
    confidence: Float[np.ndarray, "frame camera joint"],
    rig: CameraRig,
    config: Config,
) -> list[gtsam.Pose3]:
    """Poses (world_T_camera) of the cameras at the optimum over cameras and joints."""
    threshold_px = _INLIER_FACTOR * config.fusion.inlier_px
    points_m = triangulate_robust(undistorted_px, confidence, rig, threshold_px).positions_m
    known = np.asarray(np.isfinite(points_m).all(axis=-1))
    used = np.isfinite(undistorted_px).all(axis=-1) & known[:, None]
    if not known.any():
        raise ValueError(_NOTHING_TO_LEARN_FROM)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for frame, joint in np.argwhere(known).tolist():
        values.insert(position_key(joint, frame), points_m[frame, joint])
    keys = [gtsam.symbol("c", index) for index in range(rig.n_cameras)]
    for index, (key, camera) in enumerate(zip(keys, rig.cameras, strict=True)):
        values.insert(key, gtsam.Pose3(camera.world_T_camera))
        of_camera = undistorted_px[:, index], confidence[:, index], used[:, index]
        for factor in _camera_factors(key, camera, *of_camera, config):
            graph.add(factor)
    optimum = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    return [optimum.atPose3(key) for key in keys]


def _camera_factors(
    key: int,
    camera: Camera,
    undistorted_px: Float[np.ndarray, "frame joint 2"],
    confidence: Float[np.ndarray, "frame joint"],
    used: np.ndarray,
    config: Config,
) -> Iterator[gtsam.NonlinearFactor]:
    """The calibration as prior on the pose of one camera, and its detections."""
    calibration, projection = config.calibration, config.projection
    sigmas = np.repeat([np.deg2rad(calibration.rotation_sigma_deg), calibration.translation_sigma_m], 3)
    kernel = gtsam.noiseModel.mEstimator.Cauchy.Create(_BUMPED_SIGMAS)
    noise = gtsam.noiseModel.Robust.Create(kernel, gtsam.noiseModel.Diagonal.Sigmas(sigmas))
    yield gtsam.PriorFactorPose3(key, gtsam.Pose3(camera.world_T_camera), noise)
    detections = np.argwhere(used).tolist()
    counted_as_one = max(1.0, len(detections) / calibration.independent_looks)
    # The kernel goes by pixels: its scale, in sigmas, shrinks as the sigma grows.
    scale = projection.kernel_scale / np.sqrt(counted_as_one)
    for frame, joint in detections:
        weight = max(confidence[frame, joint], projection.min_weight) / counted_as_one
        noise = noise_model(2, projection.sigma_px / float(np.sqrt(weight)), projection.kernel, float(scale))
        yield gtsam.GenericProjectionFactorCal3_S2(
            undistorted_px[frame, joint], noise, key, position_key(joint, frame), camera.gtsam_intrinsics
        )


def moved_with_cameras(observations: Observations, before: CameraRig, after: CameraRig) -> Observations:
    """The views' own 3D joints, moved with their cameras."""
    points3d_m, covariance_m2 = observations.points3d_m, observations.covariance3d_m2
    if points3d_m is None:
        return observations
    moves = [new.world_T_camera @ old.camera_T_world for old, new in zip(before.cameras, after.cameras, strict=True)]
    R, t_m = np.stack(moves)[:, None, :3, :3], np.stack(moves)[:, None, :3, 3]
    return replace(
        observations,
        points3d_m=(R @ points3d_m[..., None])[..., 0] + t_m,
        covariance3d_m2=None if covariance_m2 is None else R @ covariance_m2 @ R.swapaxes(-1, -2),
    )


def _residual_px(
    undistorted_px: np.ndarray, confidence: np.ndarray, rig: CameraRig, config: Config
) -> Float[np.ndarray, " camera"]:
    points_m = triangulate_robust(undistorted_px, confidence, rig, config.fusion.inlier_px).positions_m
    errors_px = np.linalg.norm(rig.project(points_m) - undistorted_px, axis=-1).swapaxes(0, 1)
    return np.array([np.nanmedian(errors) if np.isfinite(errors).any() else np.nan for errors in errors_px])
