"""Simulated people in one room, and their true trajectories."""

from __future__ import annotations

from importlib import resources

import numpy as np

from fgpose.geometry.camera import CameraRig
from fgpose.synthetic import (
    CameraTimes,
    CrowdErrors,
    CrowdScene,
    DetectionNoise,
    Occlusion,
    crowd_motion,
    motion_from_npz,
    positions_at,
    ring_rig,
    simulate_crowd,
)
from fgpose.trajectory import Status, Trajectory


def clip(name: str) -> tuple[np.ndarray, float]:
    with resources.as_file(resources.files("fgpose").joinpath("data", "mocap_cmu", f"{name}.npz")) as path:
        return motion_from_npz(path)


def room(n_cameras: int) -> CameraRig:
    """Wide cameras under the ceiling, which see all of it."""
    return ring_rig(n_cameras, 5.0, 2.7, (0.0, 0.0, 0.9), focal_px=850.0, size_px=(1600, 1200))


def crowd(n_people: int, n_cameras: int, duration_s: float, seed: int, times: CameraTimes | None = None) -> CrowdScene:
    motion = crowd_motion(
        n_people, int(50 * duration_s), 50.0, [clip("cmu_02_01_short")], [clip("cmu_02_07_a"), clip("cmu_02_10")], seed
    )
    return simulate_crowd(motion, room(n_cameras), DetectionNoise(), Occlusion(), CrowdErrors(), seed, times)


def truth_of(scene: CrowdScene, time_s: np.ndarray) -> dict[int, Trajectory]:
    positions_m = positions_at(scene.motion, time_s)
    known = np.isfinite(positions_m).all(axis=-1)
    status = np.where(known, Status.OBSERVED, Status.UNOBSERVABLE).astype(np.int8)
    return {
        person: Trajectory(scene.motion.skeleton, time_s.copy(), positions_m[person].copy(), status[person])
        for person in range(scene.motion.n_people)
    }
