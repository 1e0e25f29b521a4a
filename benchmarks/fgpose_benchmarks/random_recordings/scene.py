"""Motion and cameras of a random recording, as they are and as they are believed to be."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from fgpose.geometry.camera import Camera, CameraRig
from fgpose_benchmarks.random_recordings.conditions import Conditions
from fgpose_benchmarks.synthetic.motion import embedded_motion
from fgpose_benchmarks.synthetic.rig import look_at

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

_MAX_FRAMES = 300  # with more, online takes longer than anybody waits
# Chosen: how different the cameras of one laboratory are.
_NEARER, _FARTHER = 0.8, 1.25
_LOWEST_M, _HIGHEST_M = 0.6, 2.8
_AIM_M = 0.2
_MIDDLE_M = 1.0  # of the person, above the floor
_CENTRE_PX = 8.0
_ASPECT = 0.01
_DISTORTION = (0.08, 0.03)


def motion_m(conditions: Conditions) -> Float[np.ndarray, "frame joint 3"]:
    """The true joints at each frame, the person's mean place at the origin."""
    return moved_m(conditions, np.arange(_n_frames(conditions)) / conditions.fps)


def moved_m(conditions: Conditions, time_s: Float[np.ndarray, " frame"]) -> Float[np.ndarray, "frame joint 3"]:
    """The true joints at any time; before and after the clip its first and last pose."""
    at_frame_m, last_frame, clip_fps = _clip(conditions.clip)
    return np.asarray(at_frame_m(np.clip(time_s * conditions.speed * clip_fps, 0, last_frame)))


def _n_frames(conditions: Conditions) -> int:
    _, last_frame, clip_fps = _clip(conditions.clip)
    duration_s = min(conditions.duration_s, last_frame / (clip_fps * conditions.speed))
    return min(int(duration_s * conditions.fps), _MAX_FRAMES)


@lru_cache(maxsize=1)  # each camera of a recording asks for it
def _clip(name: str) -> tuple[CubicSpline, int, float]:
    """The joints by frame, the last frame, and frames per second."""
    from scipy.interpolate import CubicSpline

    clip_m, fps = embedded_motion(name)
    clip_m = clip_m - clip_m[:, :1].mean(axis=0) * (1.0, 1.0, 0.0)
    return CubicSpline(np.arange(len(clip_m)), clip_m), len(clip_m) - 1, fps


def true_rig(conditions: Conditions, rng: np.random.Generator) -> CameraRig:
    """Cameras about a ring or part of one, turned roughly to the person."""
    n_cameras, arc = conditions.n_cameras, np.deg2rad(conditions.arc_deg)
    steps = n_cameras if conditions.arc_deg == 360 else max(n_cameras - 1, 1)
    first = rng.uniform(0, 2 * np.pi)
    return CameraRig(
        tuple(_camera(conditions, number, first + arc * number / steps, rng) for number in range(n_cameras))
    )


def _camera(conditions: Conditions, number: int, azimuth: float, rng: np.random.Generator) -> Camera:
    radius_m = conditions.radius_m * rng.uniform(_NEARER, _FARTHER)
    height_m = rng.uniform(_LOWEST_M, _HIGHEST_M)
    position_m = np.array([radius_m * np.cos(azimuth), radius_m * np.sin(azimuth), height_m])
    width, height = conditions.size_px
    focal_px = max(width, height) / 2 / np.tan(np.deg2rad(conditions.field_of_view_deg) / 2)
    x_px, y_px = np.array([width, height]) / 2 + rng.normal(0, _CENTRE_PX, 2)
    K = np.array([[focal_px, 0, x_px], [0, focal_px * rng.uniform(1 - _ASPECT, 1 + _ASPECT), y_px], [0, 0, 1]])
    aim_m = np.array([*rng.normal(0, _AIM_M, 2), _MIDDLE_M])
    distortion = np.array([*rng.normal(0, _DISTORTION), 0.0, 0.0, 0.0])
    return Camera(f"camera_{number}", conditions.size_px, K, look_at(position_m, aim_m), distortion)


def believed_rig(rig: CameraRig, conditions: Conditions, rng: np.random.Generator) -> CameraRig:
    """The rig as it was calibrated: each camera a little wrong. On average they are where they should be: that a whole
    rig is moved shows in nothing, so its frame is laid onto the true one."""
    from scipy.spatial.transform import Rotation

    wrong = [_miscalibrated(camera, conditions, rng) for camera in rig.cameras]
    wrong_T_true = [
        camera.world_T_camera @ true.camera_T_world for camera, true in zip(wrong, rig.cameras, strict=True)
    ]
    middle_m = np.array([0.0, 0.0, _MIDDLE_M, 1.0])
    moved = np.eye(4)
    moved[:3, :3] = Rotation.from_matrix([each[:3, :3] for each in wrong_T_true]).mean().as_matrix()
    moved[:3, 3] = np.mean([each @ middle_m for each in wrong_T_true], axis=0)[:3] - moved[:3, :3] @ middle_m[:3]
    laid = [replace(camera, world_T_camera=np.linalg.inv(moved) @ camera.world_T_camera) for camera in wrong]
    return CameraRig(tuple(laid))


def lateness_s(conditions: Conditions, n_cameras: int, rng: np.random.Generator) -> Float[np.ndarray, " camera"]:
    """How much later than it says each camera takes its images; on average they are on time."""
    late_s = conditions.late_s * rng.standard_normal(n_cameras)
    return late_s - late_s.mean()


def _miscalibrated(camera: Camera, conditions: Conditions, rng: np.random.Generator) -> Camera:
    from scipy.spatial.transform import Rotation

    turn_rad = np.deg2rad(conditions.turned_deg) * rng.standard_normal(3)
    world_T_camera, K = camera.world_T_camera.copy(), camera.K.copy()
    world_T_camera[:3, :3] = world_T_camera[:3, :3] @ Rotation.from_rotvec(turn_rad).as_matrix()
    world_T_camera[:3, 3] += conditions.moved_m * rng.standard_normal(3)
    K[:2, :2] *= 1 + conditions.zoomed * rng.standard_normal()
    return replace(camera, K=K, world_T_camera=world_T_camera)
