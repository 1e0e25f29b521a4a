"""People whose place is known, and what cameras detect of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache

import numpy as np

from fgpose.association.follow import Follower, Sighting
from fgpose.association.matching import Moment
from fgpose.geometry.camera import CameraRig
from fgpose.people_observations import Detections
from fgpose.skeleton import Skeleton
from fgpose_benchmarks.synthetic import walking

FPS = 30.0
SIGMA_PX = 3.0
"""About 1 cm at 4.5 m: less than the filter expects, as detectors mostly are."""


@cache
def _standing_m(skeleton: Skeleton) -> np.ndarray:
    return walking(1, FPS, skeleton)[0]


def body_m(skeleton: Skeleton, place_m: Sequence[float] = (0.0, 0.0), size: float = 1.0) -> np.ndarray:
    """(J, 3) of somebody who stands at a place on the floor."""
    pose_m = _standing_m(skeleton)
    middle_m = np.array([*np.median(pose_m, axis=0)[:2], 0.0])
    return size * (pose_m - middle_m) + np.array([*place_m, 0.0])


def image(
    rig: CameraRig,
    camera: int,
    time_s: float,
    people_m: Sequence[np.ndarray],
    rng: np.random.Generator | None = None,
    sigma_px: float = SIGMA_PX,
) -> Detections:
    """What a camera detects of people (J, 3), in their order; without a generator, exactly."""
    seen_by = rig.cameras[camera]
    n_joints = people_m[0].shape[0] if people_m else 17
    points_px = np.array([seen_by.project(person_m) for person_m in people_m]).reshape(-1, n_joints, 2)
    if rng is not None:
        points_px = points_px + sigma_px * rng.standard_normal(points_px.shape)
    return Detections(seen_by.name, time_s, seen_by.distort(points_px), np.full(points_px.shape[:2], 0.9))


def moment_of(rig: CameraRig, people_m: Sequence[Sequence[np.ndarray]], rng: np.random.Generator) -> Moment:
    """Of the people whom each camera detects."""
    return Moment.of([image(rig, c, 0.0, seen_m, rng) for c, seen_m in enumerate(people_m)], rig)


Scene = Callable[[int, float], Sequence[np.ndarray]]
"""The people (J, 3) whom a camera detects at a time."""


def run(
    follower: Follower, rig: CameraRig, scene: Scene, begin_s: float, end_s: float, seed: int = 0
) -> list[Sighting]:
    """All cameras at once, 30 times a second; the sightings of the last moment."""
    rng = np.random.default_rng(seed)
    sightings: list[Sighting] = []
    for time_s in np.arange(begin_s, end_s, 1.0 / FPS).tolist():
        sightings = follower.see([image(rig, c, time_s, scene(c, time_s), rng) for c in range(rig.n_cameras)])
    return sightings


def people_of(follower: Follower) -> list[int]:
    """Numbers of those who are confirmed."""
    return sorted(track.person for track in follower.tracks if track.is_confirmed)
