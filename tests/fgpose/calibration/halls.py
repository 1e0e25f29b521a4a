"""A hall of two halves with somebody in each: no single person is seen by all cameras."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fgpose.geometry.camera import CameraRig
from fgpose_benchmarks.synthetic import (
    CameraTimes,
    CrowdErrors,
    CrowdMotion,
    CrowdPlan,
    CrowdScene,
    DetectionNoise,
    Occlusion,
    crowd_motion,
    embedded_motion,
    ring_rig,
    simulate_crowd,
)

HALF_M = 3.0
"""From the middle of the hall to the middle of a half, along x."""
LEFT, RIGHT = (0, 1), (4, 5)
"""Cameras that see one half only; the others see both."""
_WALK, _WORK = "cmu_02_01_short", "cmu_02_07_a"


def hall() -> CameraRig:
    """left_0, left_1, both_0, both_1, right_0, right_1; those of a half look away from the other half."""
    size_px = (1600, 1200)
    left = ring_rig(4, 5.0, 2.6, (-HALF_M, 0.0, 0.9), 1300.0, size_px).cameras
    both = ring_rig(4, 7.0, 2.6, (0.0, 0.0, 0.8), 1000.0, size_px).cameras
    right = ring_rig(4, 5.0, 2.6, (HALF_M, 0.0, 0.9), 1300.0, size_px).cameras
    chosen = {"left": (left[0], left[3]), "both": (both[0], both[1]), "right": (right[1], right[2])}
    cameras = [replace(camera, name=f"{side}_{n}") for side, pair in chosen.items() for n, camera in enumerate(pair)]
    return CameraRig(tuple(cameras))


def hall_motion(duration_s: float, seed: int) -> CrowdMotion:
    """Somebody in the left half (person 0) and somebody in the right one."""
    plan = CrowdPlan(room_x_m=3.0, room_y_m=3.0, late_share=0.0, leaving_share=0.0, returning_share=0.0)
    clips = [embedded_motion(_WALK)], [embedded_motion(_WORK)]
    halves = [crowd_motion(1, int(50 * duration_s), 50.0, *clips, 10 * seed + half, plan) for half in (0, 1)]
    places_m = np.array([[-HALF_M, 0.0, 0.0], [HALF_M, 0.0, 0.0]])
    truth_m = [half.truth_m + place_m for half, place_m in zip(halves, places_m, strict=True)]
    return CrowdMotion(halves[0].skeleton, np.concatenate(truth_m), 50.0)


def filmed(motion: CrowdMotion, rig: CameraRig, seed: int, times: CameraTimes | None = None) -> CrowdScene:
    times = times or CameraTimes(fps=(12.5,))
    return simulate_crowd(motion, rig, DetectionNoise(), Occlusion(), CrowdErrors(), seed, times)


def off_px(rig: CameraRig, truth: CameraRig, points_m: np.ndarray) -> np.ndarray:
    """(C,) by how much each camera projects what it sees to another place than it truly would, median."""
    there_px = truth.project(points_m)
    size_px = np.array([camera.size_px for camera in truth.cameras])[:, None]
    inside = np.asarray(((there_px >= 0) & (there_px < size_px)).all(axis=-1))
    errors_px = np.linalg.norm(rig.project(points_m) - there_px, axis=-1)
    return np.array([np.median(errors_px[:, c][inside[:, c]]) for c in range(truth.n_cameras)])
