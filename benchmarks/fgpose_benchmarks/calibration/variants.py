"""The recordings of the benchmark of calibration from people.

Every draw depends on the clip, the studio and what people do: variants that differ in the errors alone show one walk.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float

from fgpose.calibration.from_people.walk import Walk
from fgpose.sampling import nearest
from fgpose_benchmarks.calibration.real import REAL, record_real
from fgpose_benchmarks.calibration.recording import Focal, Given, KnownRigRecording
from fgpose_benchmarks.synthetic import (
    Occlusion,
    SimulatedClocks,
    SimulatedNetwork,
    WalkScene,
    film,
    find_studio,
    stature_m,
    walkers,
)
from fgpose_benchmarks.synthetic.crowd.walkers import Behaviour, Clips
from fgpose_benchmarks.synthetic.noise import DetectionNoise

VERSION = 1
"""Results of one version can be compared. Whatever changes a recording is a new version."""

Group = Literal["walk", "errors", "scale", "focal length", "starts", "people", "hard", "real"]

TUNING_CLIPS = tuple(f"tuning_{n}" for n in range(1, 6))
"""Defaults may be chosen on these: people who walk and punch."""
TEST_CLIPS = tuple(f"test_{n}" for n in range(1, 6))
"""Results are stated on these: people who walk, fight with a sword and wash a window."""
DURATION_S = 30.0
"""That all videos show."""
_GUESSES = (0.2, 0.4)
"""An unknown focal length is taken to be so much too short or too long, as a share of it."""


@dataclass(frozen=True)
class CalibrationVariant:
    """Where the cameras stand, what people do and what goes wrong."""

    name: str
    group: Group
    studio: str
    """Name of a studio or, in the group real, of a recording."""
    description: str = ""
    """What differs from a walk in the studio; in a sentence without a full stop."""
    behaviour: Behaviour = "walks"
    n_people: int = 1
    network: SimulatedNetwork = field(default_factory=SimulatedNetwork)
    clocks: SimulatedClocks = field(default_factory=SimulatedClocks)
    focal: Focal = "known"
    scale: Literal["stature", "distance", "network"] = "stature"
    duration_s: float = DURATION_S


_FAR_APART = SimulatedClocks(max_start_s=60.0, min_drift_ppm=43.0, max_drift_ppm=145.0)
_MIXED_RATES = SimulatedClocks(fps=(30.0, 25.0, 50.0), max_start_s=20.0, min_drift_ppm=43.0, max_drift_ppm=145.0)
_STUDIOS = (
    "ring_3",
    "ring_4",
    "ring_8",
    "equal_4",
    "balance_4",
    "mixed_5",
    "corners_3",
    "corners_4",
    "one_sided_4",
    "one_sided_6",
)

VARIANTS = (
    *(CalibrationVariant(f"walk_{studio}", "walk", studio) for studio in _STUDIOS),
    CalibrationVariant(
        "occluded_ring_4",
        "errors",
        "ring_4",
        "An occluder before the person in every view",
        network=SimulatedNetwork(occlusion=Occlusion(n_occluders=1)),
    ),
    CalibrationVariant(
        "real_ring_4",
        "errors",
        "ring_4",
        "Errors of real detectors besides the bias",
        network=SimulatedNetwork(real=("openpose", "blazepose_full", "blazepose_heavy")),
    ),
    CalibrationVariant(
        "own_bias_ring_4",
        "errors",
        "ring_4",
        "Besides the bias of the detector, one of 10 to 20 mm that each joint has in each camera, at all times",
        network=SimulatedNetwork(noise=DetectionNoise(joint_depth_scale=0.7, min_bias_m=0.01, max_bias_m=0.02)),
    ),
    CalibrationVariant(
        "coarse_corners_4",
        "errors",
        "corners_4",
        "Noise of 12 px at 1145 px focal length, correlated over 0.4 s",
        network=SimulatedNetwork(
            noise=DetectionNoise(joint_depth_scale=0.7, sigma_px=0.0, correlated_px=12.0, correlation_s=0.4)
        ),
    ),
    CalibrationVariant(
        "no_bias_ring_4",
        "errors",
        "ring_4",
        "No view-dependent bias",
        network=SimulatedNetwork(min_bias_m=0.0, max_bias_m=0.0),
    ),
    CalibrationVariant("2d_ring_4", "errors", "ring_4", "No per-view 3D", network=SimulatedNetwork(in_3d=False)),
    CalibrationVariant("2d_mixed_5", "errors", "mixed_5", "No per-view 3D", network=SimulatedNetwork(in_3d=False)),
    CalibrationVariant("distance_ring_4", "scale", "ring_4", "Scale from a distance between cameras", scale="distance"),
    CalibrationVariant(
        "distance_corners_4", "scale", "corners_4", "Scale from a distance between cameras", scale="distance"
    ),
    CalibrationVariant("network_ring_4", "scale", "ring_4", "Scale from the network", scale="network"),
    CalibrationVariant("shared_equal_4", "focal length", "equal_4", "One unknown focal length", focal="shared"),
    CalibrationVariant("each_mixed_5", "focal length", "mixed_5", "Every focal length unknown", focal="each"),
    CalibrationVariant("each_ring_8", "focal length", "ring_8", "Every focal length unknown", focal="each"),
    CalibrationVariant(
        "phases_ring_4", "starts", "ring_4", "Within a frame", clocks=SimulatedClocks(max_start_s=1 / 30)
    ),
    CalibrationVariant("starts_ring_4", "starts", "ring_4", "Up to 60 s apart", clocks=_FAR_APART),
    CalibrationVariant("starts_mixed_5", "starts", "mixed_5", "Up to 60 s apart", clocks=_FAR_APART),
    CalibrationVariant(
        "starts_2d_corners_4",
        "starts",
        "corners_4",
        "Up to 60 s apart, no per-view 3D",
        clocks=_FAR_APART,
        network=SimulatedNetwork(in_3d=False),
    ),
    CalibrationVariant(
        "rates_one_sided_4", "starts", "one_sided_4", "Up to 20 s apart, at 30, 25 and 50 Hz", clocks=_MIXED_RATES
    ),
    # A stature would be one of them, and which one a calibration takes is its own choice.
    CalibrationVariant("people_ring_4", "people", "ring_4", "Three people", n_people=3, scale="distance"),
    CalibrationVariant("people_corners_4", "people", "corners_4", "Two people", n_people=2, scale="distance"),
    CalibrationVariant("pair", "hard", "pair", "No third view"),
    CalibrationVariant("line_ring_4", "hard", "ring_4", "To and fro on one line", behaviour="line"),
    CalibrationVariant("spot_ring_4", "hard", "ring_4", "On one spot", behaviour="spot"),
    CalibrationVariant("stands_ring_4", "hard", "ring_4", "Stands still", behaviour="stands"),
    CalibrationVariant("short_ring_4", "hard", "ring_4", "3 s of video", duration_s=3.0),
    *(CalibrationVariant(name, "real", name, text) for name, text in REAL.items()),
)


def find_variant(name: str) -> CalibrationVariant:
    """A variant by name. Raises ValueError, which lists them, for an unknown one."""
    for variant in VARIANTS:
        if variant.name == name:
            return variant
    raise ValueError(f"no variant {name!r}; there is {', '.join(variant.name for variant in VARIANTS)}")


def recordings(
    variants: Iterable[CalibrationVariant] = VARIANTS, clips: Iterable[str] = TEST_CLIPS
) -> Iterator[KnownRigRecording]:
    """The recordings of the benchmark, one after the other; of a real one there is one, whatever the clips."""
    clips = tuple(clips)
    for variant in variants:
        for clip in clips[:1] if variant.group == "real" else clips:
            yield record(variant, clip)


def record(variant: CalibrationVariant, clip: str) -> KnownRigRecording:
    """One recording.

    Raises:
        ValueError: the clip is none of TUNING_CLIPS and TEST_CLIPS, or the folder of a real recording is missing.
    """
    if clip not in TUNING_CLIPS + TEST_CLIPS:
        raise ValueError(f"no clip {clip!r}; there is {', '.join(TUNING_CLIPS + TEST_CLIPS)}")
    if variant.group == "real":
        return record_real(variant.name)
    # hash() of a string differs from process to process.
    seed = zlib.crc32(f"{clip}/{variant.studio}/{variant.behaviour}/{variant.n_people}".encode())
    studio = find_studio(variant.studio)
    kind = clip.partition("_")[0]
    clips = next(each for each in get_args(Clips) if each == kind)
    duration_s = variant.duration_s + variant.clocks.max_start_s
    motion = walkers(studio.floor_m, duration_s, seed, variant.behaviour, variant.n_people, clips)
    guess = None
    if variant.focal != "known":
        rng = np.random.default_rng(seed)
        guess = 1.0 + float(rng.choice([-1.0, 1.0]) * rng.uniform(*_GUESSES))
    scene = film(motion, studio.rig, seed, variant.network, variant.clocks, guess)
    return _recording(variant, clip, scene)


def _recording(variant: CalibrationVariant, clip: str, scene: WalkScene) -> KnownRigRecording:
    told, image_s, on_time_s = _told(scene)
    return KnownRigRecording(
        clip=clip,
        variant=variant.name,
        people=scene.observations,
        intrinsics=scene.intrinsics,
        given=_given(variant, scene),
        rig=scene.rig,
        told=told,
        image_s=image_s,
        on_time_s=on_time_s,
        joints_m=scene.joints_m(told.time_s),
        fps=min(variant.clocks.fps),
        scene=scene,
    )


def _given(variant: CalibrationVariant, scene: WalkScene) -> Given:
    """Stature and distance as somebody measures them who makes no mistake."""
    cameras = scene.rig.cameras
    # The farthest from the first: who measures one distance takes a long one.
    far = max(cameras[1:], key=lambda camera: float(np.linalg.norm(camera.position_m - cameras[0].position_m)))
    distance_m = float(np.linalg.norm(far.position_m - cameras[0].position_m))
    own_clocks = variant.clocks.max_start_s > 0 or variant.clocks.max_drift_ppm > 0
    return Given(
        focal=variant.focal,
        stature_m=stature_m(scene.motion.truth_m[0], scene.motion.skeleton) if variant.scale == "stature" else None,
        distances=((cameras[0].name, far.name, distance_m),) if variant.scale == "distance" else (),
        synchronised=not own_clocks,
    )


def _told(scene: WalkScene) -> tuple[Walk, Float[np.ndarray, "frame camera"], Float[np.ndarray, "frame camera"]]:
    """The first person, with who is who and the clocks known; see KnownRigRecording."""
    names, skeleton = scene.rig.names, scene.observations.skeleton
    first_s = scene.observations.times_s(names[0])
    true_s = scene.true_s(0, first_s)
    first_s = first_s[true_s >= scene.start_s.max()]
    shape = (len(first_s), len(names))
    image_s, on_time_s = np.full(shape, np.nan), np.full(shape, np.nan)
    points2d_px = np.full((*shape, skeleton.n_joints, 2), np.nan)
    confidence = np.zeros((*shape, skeleton.n_joints))
    points3d_m = np.full((*shape, skeleton.n_joints, 3), np.nan)
    numbers = {id(image): who for image, who in zip(scene.observations.images, scene.who, strict=True)}
    in_3d = False
    for c, name in enumerate(names):
        images, own_s = scene.observations.by_camera[name], scene.observations.times_s(name)
        by_first_s = (scene.true_s(c, own_s) - scene.start_s[0]) / scene.rate[0]
        image = nearest(first_s, by_first_s)
        near = np.abs(by_first_s[image] - first_s) <= 0.6 * np.diff(by_first_s).mean()
        for t in np.flatnonzero(near).tolist():
            shown = images[image[t]]
            image_s[t, c], on_time_s[t, c] = own_s[image[t]], by_first_s[image[t]]
            for detection in np.flatnonzero(numbers[id(shown)] == 0)[:1].tolist():
                points2d_px[t, c], confidence[t, c] = shown.points2d_px[detection], shown.confidence[detection]
                if shown.points3d_m is not None:
                    points3d_m[t, c], in_3d = shown.points3d_m[detection], True
    walk = Walk(skeleton, names, first_s, points2d_px, confidence, points3d_m if in_3d else None)
    return walk, image_s, on_time_s
