"""Simulated people in one room, and their true trajectories."""

from __future__ import annotations

from fgpose.geometry.camera import CameraRig
from fgpose_benchmarks.synthetic import (
    CameraTimes,
    CrowdErrors,
    CrowdScene,
    DetectionNoise,
    Occlusion,
    crowd_motion,
    embedded_motion,
    ring_rig,
    simulate_crowd,
)


def room(n_cameras: int) -> CameraRig:
    """Wide cameras under the ceiling, which see all of it."""
    return ring_rig(n_cameras, 5.0, 2.7, (0.0, 0.0, 0.9), focal_px=850.0, size_px=(1600, 1200))


def crowd(n_people: int, n_cameras: int, duration_s: float, seed: int, times: CameraTimes | None = None) -> CrowdScene:
    walks, works = [embedded_motion("cmu_02_01_short")], [embedded_motion("cmu_02_07_a"), embedded_motion("cmu_02_10")]
    motion = crowd_motion(n_people, int(50 * duration_s), 50.0, walks, works, seed)
    return simulate_crowd(motion, room(n_cameras), DetectionNoise(), Occlusion(), CrowdErrors(), seed, times)
