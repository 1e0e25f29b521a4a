"""Three people whose detections are exact: two walk past each other at 0.6 m, the third stands beside them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from fgpose.geometry.camera import CameraRig
from fgpose.io.skeletons import load_skeleton
from fgpose.people_observations import Detections, PeopleObservations
from fgpose_benchmarks.people.recording import PeopleRecording
from fgpose_benchmarks.synthetic import (
    NO_CROWD_ERRORS,
    NO_NOISE,
    CameraTimes,
    CrowdErrors,
    CrowdMotion,
    DetectionNoise,
    Occlusion,
    ring_rig,
    simulate_crowd,
    walking,
)

EXACT_BEHIND_OTHERS = Occlusion(hallucination_px=0.0, missing_share=0.0)
_FPS = 30.0
_SPEED_RADPS = 1.2  # of walking(), on a circle of 1 m


def room(n_cameras: int) -> CameraRig:
    """Cameras that see everybody."""
    return ring_rig(n_cameras, 5.0, 2.7, (0.0, 0.0, 0.9), focal_px=850.0, size_px=(1600, 1200))


def passing(n_people: int = 3, n_frames: int = 15) -> CrowdMotion:
    """In the middle of the recording the first two are 0.6 m apart."""
    skeleton = load_skeleton("h36m_17")
    circle_m = walking(int(2 * np.pi / _SPEED_RADPS * _FPS) + n_frames, _FPS, skeleton)

    def around(centre_m: tuple[float, float], heading_in_the_middle: float) -> np.ndarray:
        first = round(heading_in_the_middle / _SPEED_RADPS * _FPS) - n_frames // 2
        return circle_m[first : first + n_frames] + np.array([*centre_m, 0.0])

    standing_m = np.tile(circle_m[:1] + np.array([0.0, 3.0, 0.0]), (n_frames, 1, 1))
    people_m = [around((-1.3, 0.0), np.pi / 2), around((1.3, 0.0), 3 * np.pi / 2), standing_m]
    return CrowdMotion(skeleton, np.stack(people_m[:n_people]), _FPS)


def recorded(
    motion: CrowdMotion,
    n_cameras: int = 4,
    errors: CrowdErrors = NO_CROWD_ERRORS,
    noise: DetectionNoise = NO_NOISE,
    times: CameraTimes | None = None,
) -> PeopleRecording:
    """What the cameras deliver; without errors all joints exactly, those behind somebody too."""
    scene = simulate_crowd(motion, room(n_cameras), noise, EXACT_BEHIND_OTHERS, errors, 0, times)
    return PeopleRecording("passing", "exact", scene)


def changed(recording: PeopleRecording, change: Callable[[Detections], Detections]) -> PeopleRecording:
    """The recording with other images; who is who in them is not asked for."""
    before = recording.observations
    images = tuple(change(image) for image in before.images)
    observations = PeopleObservations(before.skeleton, before.camera_names, images)
    return replace(recording, scene=replace(recording.scene, observations=observations))
