"""Random recordings of several people: who is who, where rig and detections are as bad as they are for one person."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.people_observations import Detections, PeopleObservations
from fgpose_benchmarks.people.recording import PeopleRecording
from fgpose_benchmarks.random_recordings.conditions import Conditions, draw, pick
from fgpose_benchmarks.random_recordings.errors import detection_error_m, stated_confidence, with_outliers
from fgpose_benchmarks.random_recordings.recording import VARIANT
from fgpose_benchmarks.random_recordings.scene import believed_rig, lateness_s, true_rig
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
    """How a recording of several people was made."""

    detector: Conditions
    """Of the rig, and of the errors of joints that are seen."""
    n_people: int
    """Fewer where so many find no way around each other."""
    duration_s: float
    clocks: str
    """one: images are taken at once; phases: each camera begins when it likes; rates: and every other is slower."""
    plan: CrowdPlan
    errors: CrowdErrors
    occlusion: Occlusion


def draw_crowd(seed: int) -> CrowdConditions:
    """The conditions of a recording; of a seed always the same.

    Raises:
        ValueError: the seed is negative.
    """
    detector, rng = draw(seed), _rng(seed, 0)
    rig, crowd = ({name: pick(rng, options) for name, options in each.items()} for each in (_RIG, _CROWD))

    def of(kind: type[CrowdPlan | CrowdErrors | Occlusion]) -> dict[str, Any]:
        return {field.name: crowd[field.name] for field in fields(kind) if field.name in crowd}

    room_m, (slowest_mps, fastest_mps) = crowd["room_m"], crowd["speed_mps"]
    room = {"room_x_m": room_m, "room_y_m": room_m, "min_speed_mps": slowest_mps, "max_speed_mps": fastest_mps}
    return CrowdConditions(
        detector=replace(detector, **rig),
        n_people=crowd["n_people"],
        duration_s=crowd["duration_s"],
        clocks=crowd["clocks"],
        plan=CrowdPlan(**room, **of(CrowdPlan)),
        errors=CrowdErrors(**of(CrowdErrors)),
        occlusion=Occlusion(confidence=detector.hidden_confidence, **of(Occlusion)),
    )


def crowds(seeds: Iterable[int]) -> Iterator[PeopleRecording]:
    """One recording for each seed, named after it; the same at each call. Raises ValueError if a seed is negative."""
    return (record_crowd(draw_crowd(seed)) for seed in seeds)


def record_crowd(conditions: CrowdConditions) -> PeopleRecording:
    """A recording under these conditions."""
    detector = conditions.detector
    rng, seed = _rng(detector.seed, 1), detector.seed
    rig = true_rig(detector, rng)
    believed = believed_rig(rig, detector, rng)
    late_s = lateness_s(detector, rig.n_cameras, rng)
    rig = CameraRig(
        tuple(replace(camera, time_offset_s=float(late)) for camera, late in zip(rig.cameras, late_s, strict=True))
    )
    rates = (detector.fps, _SLOWER * detector.fps) if conditions.clocks == "rates" else (detector.fps,)
    times = CameraTimes(rates, conditions.clocks != "one")
    scene = simulate_crowd(_motion(conditions), rig, NO_NOISE, conditions.occlusion, conditions.errors, seed, times)
    observations = _detected(scene, detector, rng)
    return PeopleRecording(f"{seed:04d}", VARIANT, replace(scene, observations=observations, rig=believed))


def _rng(seed: int, stream: int) -> np.random.Generator:
    return np.random.default_rng((seed, stream))


def _motion(conditions: CrowdConditions) -> CrowdMotion:
    walks, works = [embedded_motion(_WALK)], [embedded_motion(name) for name in _WORKS]
    n_frames, seed = int(conditions.duration_s * _TRUTH_FPS) + 1, conditions.detector.seed
    n_people = conditions.n_people
    while True:
        try:
            return crowd_motion(n_people, n_frames, _TRUTH_FPS, walks, works, seed, conditions.plan)
        except ValueError:
            if n_people == 1:
                raise
            n_people -= 1  # they find no way around each other


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
    points_px = image.points2d_px + off_m * px_per_m[:, None, None]
    points_px, _ = with_outliers(points_px, px_per_m[:, None], detector, rng)
    stated = np.where(image.confidence > 0, stated_confidence(off_m, hidden, detector, rng), 0.0)
    return replace(image, points2d_px=points_px, confidence=stated)
