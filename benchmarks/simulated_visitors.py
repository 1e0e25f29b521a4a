"""People who come into a room and go, again and again: a few recordings whose truth is known, in random order."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from fgpose.geometry.camera import CameraRig
from fgpose.live.frame import LiveFrame
from fgpose.people_observations import Detections
from fgpose_benchmarks.synthetic import (
    CameraTimes,
    CrowdErrors,
    CrowdPlan,
    CrowdScene,
    DetectionNoise,
    Occlusion,
    crowd_motion,
    embedded_motion,
    ring_rig,
    simulate_crowd,
)

_TRUTH_FPS = 50.0
_MINUTE_S = 60.0
# Nobody is that far from where they are said to be.
_OTHER_M = 0.5
_NOWHERE_M = 100.0
_N_PEOPLE = (1, 2, 1, 1, 2, 1)
"""Of each clip."""


def room_rig(n_cameras: int = 4) -> CameraRig:
    """Around a room of 6 x 6 m."""
    return ring_rig(n_cameras, 5.0, 2.7, (0.0, 0.0, 0.9), focal_px=850.0, size_px=(1600, 1200))


@dataclass(frozen=True, eq=False)
class SimulatedClip:
    """People for some seconds, as detectors see them: the same errors whenever it is played."""

    scene: CrowdScene
    images: dict[str, tuple[Detections, ...]]
    """Of each camera."""

    @staticmethod
    def made(rig: CameraRig, n_people: int, duration_s: float, rate_hz: float, seed: int) -> SimulatedClip:
        walks, works = [embedded_motion("cmu_02_01_short")], [embedded_motion("cmu_02_07_a")]
        plan, n_frames = CrowdPlan(returning_share=0.0), int(duration_s * _TRUTH_FPS) + 1
        motion = crowd_motion(n_people, n_frames, _TRUTH_FPS, walks, works, seed, plan)
        times = CameraTimes(fps=(rate_hz,))
        scene = simulate_crowd(motion, rig, DetectionNoise(), Occlusion(), CrowdErrors(), seed, times)
        return SimulatedClip(scene, {name: tuple(images) for name, images in scene.observations.by_camera.items()})

    @property
    def n_images(self) -> int:
        """Of each camera."""
        return min(map(len, self.images.values()))

    def truth_m(self, at_s: float) -> Float[np.ndarray, "person joint 3"]:
        """NaN: not there. Between two frames of motion capture, people go straight on."""
        truth_m = self.scene.motion.truth_m
        frame = min(max(at_s, 0.0) * _TRUTH_FPS, truth_m.shape[1] - 1.001)
        before, share = int(frame), frame % 1
        return (1 - share) * truth_m[:, before] + share * truth_m[:, before + 1]


@dataclass(frozen=True)
class Scores:
    """A frame against the truth."""

    error_m: Float[np.ndarray, " person"]
    """Mean over the joints, of every true person; NaN: not there, or nobody is said to be near."""
    sigma_m: Float[np.ndarray, " person"]
    """Mean standard deviation of the joints in one direction."""
    is_there: np.ndarray
    """(person,) in truth"""
    n_others: int
    """Who are said to be there and are not."""


def scores(truth_m: Float[np.ndarray, "person joint 3"], frame: LiveFrame) -> Scores:
    """Who is nearest is taken for the same."""
    from scipy.optimize import linear_sum_assignment

    n = len(truth_m)
    error_m, sigma_m = np.full(n, np.nan), np.full(n, np.nan)
    is_there = np.asarray(np.isfinite(truth_m).all(axis=(1, 2)))
    there, n_found = np.flatnonzero(is_there), 0
    if frame.people and len(there):
        said_m = np.stack([person.positions_m for person in frame.people])
        joint_m = np.linalg.norm(said_m[:, None] - truth_m[there], axis=-1)
        known = np.isfinite(joint_m)
        apart_m = np.where(known, joint_m, 0.0).sum(axis=-1) / np.maximum(known.sum(axis=-1), 1)
        apart_m = np.where(known.any(axis=-1), apart_m, _NOWHERE_M)
        for who, whose in zip(*linear_sum_assignment(apart_m), strict=True):
            if apart_m[who, whose] < _OTHER_M:
                n_found += 1
                error_m[there[whose]] = apart_m[who, whose]
                variances_m2 = np.trace(frame.people[who].covariance_m2, axis1=1, axis2=2) / 3
                sigma_m[there[whose]] = np.sqrt(np.nanmean(variances_m2))
    return Scores(error_m, sigma_m, is_there, len(frame.people) - n_found)


@dataclass(frozen=True)
class Visit:
    clip: int
    first: int
    """Number of the image with which it begins."""


class Visitors:
    """What the cameras see: a visit in some of the minutes.

    Args:
        clips: all recordings.
        start_s: Unix time of image 0.
        rate_hz: of the images.
        visit: that of each minute, if there is one.
    """

    def __init__(
        self, clips: Sequence[SimulatedClip], start_s: float, rate_hz: float, visit: Callable[[int], Visit | None]
    ) -> None:
        self._clips, self._start_s, self._rate_hz = clips, start_s, rate_hz
        self._visit = lru_cache(maxsize=4)(visit)
        n_joints = clips[0].scene.motion.skeleton.n_joints
        empty = np.zeros((0, n_joints, 2)), np.zeros((0, n_joints))
        self._nobody = {name: Detections(name, 0.0, *empty) for name in clips[0].images}

    def seen(self, camera: str, number: int) -> Detections:
        """What is found in an image."""
        visit = self.of(number)
        if visit is None:
            return self._nobody[camera]
        return self._clips[visit.clip].images[camera][number - visit.first]

    def of(self, number: int) -> Visit | None:
        """The visit that an image shows."""
        visit = self._visit(int(number / self._rate_hz / _MINUTE_S))
        if visit is None or not 0 <= number - visit.first < self._clips[visit.clip].n_images:
            return None
        return visit

    def number(self, time_s: float) -> float:
        """Of the image that would be taken at a time."""
        return (time_s - self._start_s) * self._rate_hz

    def score(self, frame: LiveFrame) -> tuple[Visit, int, Scores] | None:
        """A frame against the truth, and the number of its image in the clip; None: nobody is there."""
        # It has no time before the first image.
        number = self.number(frame.time_s)
        visit = None if math.isnan(number) else self.of(int(number))
        if visit is None:
            return None
        at = number - visit.first
        return visit, int(at), scores(self._clips[visit.clip].truth_m(at / self._rate_hz), frame)


def made_clips(rig: CameraRig, duration_s: float, rate_hz: float, seed: int) -> list[SimulatedClip]:
    """Walks and work of one person and of two."""
    return [SimulatedClip.made(rig, n, duration_s, rate_hz, 100 * seed + k) for k, n in enumerate(_N_PEOPLE)]
