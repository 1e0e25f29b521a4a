"""Recordings whose truth is known, and what is done to them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.io.skeletons import load_skeleton
from fgpose.observations import Observations
from fgpose_benchmarks.synthetic import NO_OCCLUSION, DetectionNoise, embedded_motion, real_errors, simulate
from fgpose_benchmarks.synthetic.rig import look_at

SKELETON = load_skeleton("h36m_17")
SIZE_PX = (1920, 1080)
FPS = 30.0


def room(n_cameras: int = 4, seed: int = 0) -> CameraRig:
    """Cameras around the origin, at different heights and distances, with lenses that distort a little."""
    rng, cameras = np.random.default_rng(seed), []
    for c in range(n_cameras):
        angle = 2 * np.pi * c / n_cameras * (0.8 if n_cameras > 2 else 0.6) + rng.uniform(-0.2, 0.2)
        radius_m, height_m = rng.uniform(3.8, 5.5), rng.uniform(1.2, 2.8)
        position_m = np.array([radius_m * np.cos(angle), radius_m * np.sin(angle), height_m])
        target_m = np.array([*rng.uniform(-0.3, 0.3, 2), 0.95])
        K = np.array([[1400.0, 0, 960 + rng.uniform(-20, 20)], [0, 1400.0, 540 + rng.uniform(-20, 20)], [0, 0, 1]])
        pose = look_at(position_m, target_m)
        cameras.append(Camera(f"cam{c + 1}", SIZE_PX, K, pose, np.array([-0.1, 0.03, 0.0, 0.0])))
    return CameraRig(tuple(cameras))


def motion_m(clip: str = "cmu_02_05", n_frames: int = 150) -> np.ndarray:
    """Real motion around the origin, at 30 frames a second."""
    truth_m, fps = embedded_motion(clip)
    truth_m = truth_m[:: max(round(fps / FPS), 1)][:n_frames]
    return truth_m - np.array([*truth_m[:, 0].mean(axis=0)[:2], 0.0])


def recorded(
    rig: CameraRig, truth_m: np.ndarray | None = None, seed: int = 0, detector: str = "openpose"
) -> Observations:
    """With the errors of a real detector."""
    truth_m = motion_m() if truth_m is None else truth_m
    errors = real_errors(np.random.default_rng(seed), len(truth_m), rig.n_cameras, SKELETON, FPS, (detector,))
    return simulate(truth_m, SKELETON, rig, FPS, DetectionNoise(), NO_OCCLUSION, seed, None, errors).observations


def with_points(seen: Observations, points_px: np.ndarray, order: list[int] | None = None) -> Observations:
    """Other keypoints, of cameras in another order if there is one."""
    confidence = seen.confidence if order is None else seen.confidence[:, order]
    return replace(seen, points2d_px=points_px, confidence=confidence, points3d_m=None, covariance3d_m2=None)


def changed(seen: Observations, change: Callable[[np.ndarray], np.ndarray], cameras: tuple[int, ...]) -> Observations:
    """Keypoints of some cameras changed."""
    points_px = seen.points2d_px.copy()
    for c in cameras:
        points_px[:, c] = change(points_px[:, c])
    return with_points(seen, points_px)


def posed(rig: CameraRig, pose: Callable[[np.ndarray], np.ndarray]) -> CameraRig:
    """All cameras with other poses."""
    return CameraRig(tuple(replace(each, world_T_camera=pose(np.array(each.world_T_camera))) for each in rig.cameras))


def turned_clockwise(points_px: np.ndarray) -> np.ndarray:
    """Of images that were turned by 90 degrees."""
    return np.stack([SIZE_PX[1] - 1 - points_px[..., 1], points_px[..., 0]], axis=-1)


def upside_down(points_px: np.ndarray) -> np.ndarray:
    return np.array(SIZE_PX) - 1 - points_px


def mirrored(points_px: np.ndarray) -> np.ndarray:
    """As a front camera shows somebody: left and right change places, for the network too."""
    flipped = np.stack([SIZE_PX[0] - 1 - points_px[..., 0], points_px[..., 1]], axis=-1)
    return flipped[..., SKELETON.mirror, :]
