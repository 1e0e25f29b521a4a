"""Random recordings of several people: who is who, where rig and detections are as bad as they are for one person."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.people_observations import Detections, PeopleObservations
from fgpose_benchmarks.people.recording import PeopleRecording
from fgpose_benchmarks.random_recordings.conditions import Conditions, draw, pick
from fgpose_benchmarks.random_recordings.errors import detection_error_m, stated_confidence
from fgpose_benchmarks.random_recordings.recording import VARIANT
from fgpose_benchmarks.random_recordings.scene import believed_rig, true_rig
from fgpose_benchmarks.synthetic import (
    NO_NOISE,
    CameraTimes,
    CrowdErrors,
    CrowdMotion,
    CrowdPlan,
    CrowdScene,
    Occlusion,
    crowd_motion,
    embedded_motion,
    positions_at,
    simulate_crowd,
)

_TRUTH_FPS = 50.0
_WALK, _WORKS = "cmu_02_01_short", ("cmu_02_05", "cmu_02_07_a", "cmu_02_10")
_SLOWER = 0.8  # every other camera, where rates differ
_OUTLIER_M = 0.3

# Of rig and detections, in place of those for one person: nobody sees a whole room from 3 m.
_RIG: dict[str, Sequence[Any]] = {
    "fps": (15.0, 25.0, 30.0, 60.0),
    "n_cameras": (2, 3, 4, 4, 5, 6, 8),
    "radius_m": (4.0, 5.5, 7.0),
    "field_of_view_deg": (60.0, 75.0, 95.0),
    "arc_deg": (360.0, 360.0, 180.0),
    "bias_m": (0.0, 0.01, 0.03),
}
_CROWD: dict[str, Sequence[Any]] = {
    "n_people": (1, 2, 2, 3, 4, 6, 8),
    "duration_s": (6.0, 12.0, 20.0),
    "clocks": ("one", "one", "phases", "rates"),
    "room_m": (3.0, 5.0, 7.0),
    "speed_mps": ((0.3, 0.8), (0.7, 1.4), (1.5, 2.5)),
    "returning_share": (0.0, 0.5, 1.0),
    "away_s": (3.0, 5.0, 8.0),
    "missed_share": (0.0, 0.02, 0.1, 0.3),
    "missed_s": (0.0, 0.3, 1.0),
    "doubled_share": (0.0, 0.01, 0.1),
    "flipped_share": (0.0, 0.02, 0.1),
    "grabbed_share": (0.0, 0.3, 0.6),
    "false_people": (0.0, 0.05, 0.5),
    "min_visible_joints": (1, 4, 8, 12),
    "missing_share": (0.0, 0.1, 0.5, 1.0),
    "hallucination_px": (15.0, 45.0, 90.0),
    "own_body": (False, True),
}


@dataclass(frozen=True, kw_only=True)
class CrowdConditions:
    """How a recording of several people was made; the errors as those of CrowdErrors and Occlusion."""

    detector: Conditions
    """Of the rig, and of the errors of joints that are seen."""
    n_people: int
    """Fewer where so many find no way around each other."""
    duration_s: float
    clocks: str
    """one: images are taken at once; phases: each camera begins when it likes; rates: and every other is slower."""
    room_m: float
    speed_mps: tuple[float, float]
    returning_share: float
    away_s: float
    missed_share: float
    missed_s: float
    doubled_share: float
    flipped_share: float
    grabbed_share: float
    false_people: float
    min_visible_joints: int
    missing_share: float
    """Of the joints that are hidden."""
    hallucination_px: float
    own_body: bool


def draw_crowd(seed: int) -> CrowdConditions:
    """The conditions of a recording; of a seed always the same.

    Raises:
        ValueError: the seed is negative.
    """
    detector, rng = draw(seed), _rng(seed, 0)
    rig, crowd = ({name: pick(rng, options) for name, options in each.items()} for each in (_RIG, _CROWD))
    return CrowdConditions(detector=replace(detector, **rig), **crowd)


def crowds(seeds: Iterable[int]) -> Iterator[PeopleRecording]:
    """One recording for each seed, named after it; the same at each call. Raises ValueError if a seed is negative."""
    return (record_crowd(draw_crowd(seed)) for seed in seeds)


def record_crowd(conditions: CrowdConditions) -> PeopleRecording:
    """A recording under these conditions."""
    detector = conditions.detector
    rng, seed = _rng(detector.seed, 1), detector.seed
    rig = true_rig(detector, rng)
    believed = believed_rig(rig, detector, rng)
    late_s = detector.late_s * rng.standard_normal(rig.n_cameras)
    late_s -= late_s.mean()
    rig = CameraRig(
        tuple(replace(camera, time_offset_s=float(late)) for camera, late in zip(rig.cameras, late_s, strict=True))
    )
    rates = (detector.fps, _SLOWER * detector.fps) if conditions.clocks == "rates" else (detector.fps,)
    errors = CrowdErrors(
        **{name: getattr(conditions, name) for name in vars(CrowdErrors()) if hasattr(conditions, name)}
    )
    occlusion = Occlusion(
        hallucination_px=conditions.hallucination_px,
        missing_share=conditions.missing_share,
        confidence=detector.hidden_confidence,
    )
    times = CameraTimes(rates, conditions.clocks != "one")
    scene = simulate_crowd(_motion(conditions), rig, NO_NOISE, occlusion, errors, seed, times)
    observations = _detected(scene, detector, rng)
    return PeopleRecording(f"{seed:04d}", VARIANT, replace(scene, observations=observations, rig=believed))


def _rng(seed: int, stream: int) -> np.random.Generator:
    return np.random.default_rng((seed, stream))


def _motion(conditions: CrowdConditions) -> CrowdMotion:
    slowest, fastest = conditions.speed_mps
    plan = CrowdPlan(
        room_x_m=conditions.room_m,
        room_y_m=conditions.room_m,
        returning_share=conditions.returning_share,
        away_s=conditions.away_s,
        min_speed_mps=slowest,
        max_speed_mps=fastest,
    )
    works, n_frames = [embedded_motion(name) for name in _WORKS], int(conditions.duration_s * _TRUTH_FPS) + 1
    for n_people in range(conditions.n_people, 1, -1):
        try:
            seed = conditions.detector.seed
            return crowd_motion(n_people, n_frames, _TRUTH_FPS, [embedded_motion(_WALK)], works, seed, plan)
        except ValueError:  # they find no way around each other
            continue
    return crowd_motion(1, n_frames, _TRUTH_FPS, [embedded_motion(_WALK)], works, conditions.detector.seed, plan)


def _detected(scene: CrowdScene, detector: Conditions, rng: np.random.Generator) -> PeopleObservations:
    """What the detector makes of the true pixels of joints; those that are hidden have its errors too."""
    observations, by_camera = scene.observations, scene.observations.by_camera
    n_images, n_people = max(map(len, by_camera.values())), scene.motion.n_people
    shape = (n_images, len(observations.camera_names), observations.skeleton.n_joints)
    # One more for people who are not there.
    errors_m = np.stack([detection_error_m(shape, detector, rng) for _ in range(n_people + 1)])
    place_m = {
        name: positions_at(scene.motion, np.array([image.time_s for image in images])).mean(axis=2)
        for name, images in by_camera.items()
    }
    number, found = dict.fromkeys(observations.camera_names, 0), []
    for image, who, hidden in zip(observations.images, scene.who, scene.hidden, strict=True):
        t, c = number[image.camera], observations.camera_names.index(image.camera)
        number[image.camera] += 1
        depth_m = _depth_m(scene.rig.cameras[c], place_m[image.camera][:, t], who, detector)
        off_m = errors_m[who, t, c]
        found.append(_erred(image, off_m, scene.rig.cameras[c].K[0, 0] / depth_m, hidden, detector, rng))
    return PeopleObservations(observations.skeleton, observations.camera_names, tuple(found))


def _depth_m(
    camera: Camera, place_m: Float[np.ndarray, "person 3"], who: Int[np.ndarray, " _"], detector: Conditions
) -> Float[np.ndarray, " _"]:
    """Of everybody in an image; of who is not there, that of the middle of the room."""
    depth_m = np.nan_to_num(camera.to_camera_frame(place_m)[:, 2], nan=detector.radius_m)
    return np.maximum(np.append(depth_m, detector.radius_m)[who], 1.0)


def _erred(
    image: Detections,
    off_m: Float[np.ndarray, "person joint 2"],
    px_per_m: Float[np.ndarray, " person"],
    hidden: Bool[np.ndarray, "person joint"],
    detector: Conditions,
    rng: np.random.Generator,
) -> Detections:
    if not image.n_people:
        return image
    outlier = rng.random(hidden.shape) < detector.outlier_share
    far_m = _OUTLIER_M * rng.standard_normal(off_m.shape)
    points_px = image.points2d_px + (off_m + np.where(outlier[..., None], far_m, 0.0)) * px_per_m[:, None, None]
    if detector.stride_px:
        points_px = np.round(points_px / detector.stride_px) * detector.stride_px
    stated = np.where(image.confidence > 0, stated_confidence(off_m, hidden, detector, rng), 0.0)
    return replace(image, points2d_px=points_px, confidence=stated)
