"""What a bundle adjustment gives: the true rig with small errors, in a gauge of its own, and the joints through it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import gtsam
import numpy as np

from fgpose.assessment.rig_alignment import Similarity
from fgpose.calibration.from_people.walk import Walk
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.triangulation import triangulate_robust
from fgpose.skeleton import Skeleton
from fgpose_benchmarks.synthetic import CrowdPlan, crowd_motion, embedded_motion, ring_rig

FPS = 12.5
_PLAN = {"late_share": 0.0, "leaving_share": 0.0, "returning_share": 0.0, "working_share": 0.3}


@cache
def walker(seconds: float, seed: int) -> tuple[np.ndarray, Skeleton]:
    """(T, J, 3) of somebody who walks in a room of 4 m, world frame with the floor at z = 0."""
    clips = [embedded_motion("cmu_02_01_short")], [embedded_motion("cmu_02_07_a")]
    plan = CrowdPlan(4.0, 4.0, min_stop_s=0.3, max_stop_s=1.5, **_PLAN)
    motion = crowd_motion(1, int(seconds * FPS), FPS, *clips, seed, plan)
    return motion.truth_m[0], motion.skeleton


@dataclass(frozen=True, eq=False)
class Adjusted:
    truth_m: np.ndarray
    true_rig: CameraRig
    walk: Walk
    rig: CameraRig
    """In its own gauge."""
    joints_m: np.ndarray
    gauge_T_true: Similarity

    def true_T(self, world_T_gauge: Similarity) -> Similarity:
        """The true world in the world that was found."""
        return then(self.gauge_T_true, world_T_gauge)


def then(first: Similarity, second: Similarity) -> Similarity:
    return Similarity(first.scale * second.scale, second.R @ first.R, second.of(first.offset_m))


def adjusted(
    seconds: float = 30.0, seed: int = 0, bias_m: float = 0.03, error_m: float = 0.02, noise_px: float = 4.0
) -> Adjusted:
    """Of a walker before four cameras."""
    truth_m, skeleton = walker(seconds, seed)
    rng = np.random.default_rng(seed)
    true_rig = ring_rig(4, 4.5, 1.7, (0.0, 0.0, 0.9))
    px = detections_px(truth_m, skeleton, true_rig, bias_m, rng) + noise_px * rng.standard_normal(
        (*truth_m.shape[:1], 4, 17, 2)
    )
    confidence = np.full(px.shape[:-1], 0.8)
    with_errors = moved(true_rig, rig_errors(true_rig, error_m, rng))
    joints_m = triangulate_robust(px, confidence, with_errors).positions_m
    first = with_errors.cameras[0]
    # About the first camera, with another unit than metres.
    unit = 0.93
    gauge_T_true = Similarity(unit, first.camera_T_world[:3, :3], unit * first.camera_T_world[:3, 3])
    time_s = np.arange(len(truth_m)) / FPS
    walk = Walk(skeleton, true_rig.names, time_s, px, confidence)
    return Adjusted(truth_m, true_rig, walk, gauge_T_true.rig(with_errors), gauge_T_true.of(joints_m), gauge_T_true)


def detections_px(
    truth_m: np.ndarray, skeleton: Skeleton, rig: CameraRig, bias_m: float, rng: np.random.Generator
) -> np.ndarray:
    """(T, C, J, 2) with a bias of each joint, of this root mean square, that depends on the azimuth from which the
    camera sees the body, the same for all cameras."""
    left, right = skeleton.index("left_hip"), skeleton.index("right_hip")
    across_m = truth_m[:, left] - truth_m[:, right]
    heading = np.arctan2(across_m[:, 1], across_m[:, 0]) - np.pi / 2
    amplitudes = bias_m / 2 * rng.standard_normal((skeleton.n_joints, 2, 4))
    px = []
    for camera in rig.cameras:
        to_camera_m = camera.position_m[:2] - truth_m[:, 0, :2]
        azimuth = np.arctan2(to_camera_m[:, 1], to_camera_m[:, 0]) - heading
        waves = np.stack([np.cos(azimuth), np.sin(azimuth), np.cos(2 * azimuth), np.sin(2 * azimuth)])
        in_image_m = np.einsum("jak,kt->tja", amplitudes, waves)
        in_camera_m = camera.to_camera_frame(truth_m)
        in_camera_m[..., :2] += in_image_m
        px.append(camera.project(camera.to_world_frame(in_camera_m)))
    return np.stack(px, axis=1)


def rig_errors(rig: CameraRig, error_m: float, rng: np.random.Generator) -> np.ndarray:
    """(C, 6): places off by this much along each axis, turned so that the middle of the room stays in the image where
    it is, and by 0.1 degrees more."""
    errors = np.zeros((rig.n_cameras, 6))
    for c, camera in enumerate(rig.cameras):
        middle_m = camera.to_camera_frame(np.array([0.0, 0.0, 0.9]))
        errors[c, 3:] = error_m * rng.standard_normal(3)
        # A point p seen from e is at p - e; the turn w brings it back: w x p = -e across the ray.
        errors[c, :3] = -np.cross(middle_m, errors[c, 3:]) / (middle_m @ middle_m)
        errors[c, :3] += np.deg2rad(0.1) * rng.standard_normal(3)
    return errors


def moved(rig: CameraRig, errors: np.ndarray) -> CameraRig:
    """Each camera turned and moved in its own frame."""
    cameras = []
    for camera, error in zip(rig.cameras, errors, strict=True):
        pose = gtsam.Pose3(camera.world_T_camera).compose(gtsam.Pose3(gtsam.Rot3.Expmap(error[:3]), error[3:]))
        cameras.append(replace(camera, world_T_camera=pose.matrix()))
    return CameraRig(tuple(cameras))


def angle_deg(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.rad2deg(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))
