"""A walker before three cameras whose videos begin up to 8 s apart, and tracks that are made by hand."""

from __future__ import annotations

from functools import cache

import numpy as np

from fgpose.calibration.from_people.starts.walker import main_tracks
from fgpose.calibration.from_people.tracks import find_tracks
from fgpose.calibration.from_people.walk import Track
from fgpose.geometry.camera import CameraRig
from fgpose.skeleton import Skeleton
from fgpose_benchmarks.synthetic import ring_rig
from fgpose_benchmarks.synthetic.crowd.walkers import walkers
from fgpose_benchmarks.synthetic.uncalibrated import SimulatedClocks, SimulatedNetwork, WalkScene, film

FPS = (30.0, 25.0, 50.0)


@cache
def walk_scene() -> WalkScene:
    """35 s, detections with noise, outliers, exchanged sides and a bias of 20 to 40 mm."""
    motion = walkers((4.0, 4.0), 35.0, 3)
    return film(motion, ring_rig(3, 4.5, 1.9), 3, SimulatedNetwork(), SimulatedClocks(FPS, 8.0, 40.0, 145.0))


@cache
def walk_tracks() -> tuple[Track, ...]:
    scene = walk_scene()
    return main_tracks(find_tracks(scene.observations), scene.observations.skeleton)


def true_offset_s(scene: WalkScene, camera: int, own_s: float) -> float:
    """Time by the clock of the first camera less that by the camera's own."""
    return float((scene.true_s(camera, np.array([own_s]))[0] - scene.start_s[0]) / scene.rate[0]) - own_s


def bodies_px(skeleton: Skeleton, n_images: int, fps: float = 25.0, seed: int = 0) -> np.ndarray:
    """(T, J, 2) somebody 200 px high who walks to the right at 100 px/s; limbs swing."""
    rng = np.random.default_rng(seed)
    shape_px = np.stack([rng.uniform(-30, 30, skeleton.n_joints), rng.uniform(-100, 100, skeleton.n_joints)], axis=-1)
    for left, right in skeleton.left_right:
        shape_px[left, 0], shape_px[right, 0] = 25.0, -25.0
        shape_px[right, 1] = shape_px[left, 1]
    time_s = np.arange(n_images) / fps
    swing_px = 10 * np.sin(2 * np.pi * time_s[:, None] + rng.uniform(0, 6, skeleton.n_joints))
    points_px = shape_px + np.stack([swing_px, swing_px], axis=-1)
    return points_px + np.stack([300 + 100 * time_s, np.full(n_images, 400.0)], axis=-1)[:, None]


def track_of(points2d_px: np.ndarray, fps: float = 25.0, camera: str = "a", start_s: float = 0.0) -> Track:
    known = np.isfinite(points2d_px).all(axis=-1)
    return Track(camera, start_s + np.arange(len(points2d_px)) / fps, points2d_px, np.where(known, 0.9, 0.0))


def intrinsics_of(tracks: tuple[Track, ...]) -> CameraRig:
    return walk_scene().intrinsics.subset([track.camera for track in tracks])
