"""The recordings of the benchmark of several people: simulated crowds, the true motion of which is known.

Every draw depends on the clip alone: the variants of a clip with the same number of people have the same motion.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from fgpose.geometry.camera import CameraRig
from fgpose_benchmarks.people.recording import PeopleRecording
from fgpose_benchmarks.synthetic import (
    CameraTimes,
    CrowdErrors,
    CrowdPlan,
    DetectionNoise,
    Furniture,
    Occlusion,
    Seat,
    crowd_motion,
    embedded_motion,
    ring_rig,
    simulate_crowd,
)

VERSION = 1
"""Results of one version can be compared. Whatever changes a recording is a new version."""

Group = Literal["high cameras", "low cameras", "furniture", "unsynchronised", "sitting"]

_WALKS = ("cmu_02_01_short",)
_WORKS = {"tuning": ("cmu_02_05",), "test": ("cmu_02_07_a", "cmu_02_10")}
TUNING_CLIPS = ("tuning_1", "tuning_2", "tuning_3")
"""Defaults may be chosen on these: people who walk and punch."""
TEST_CLIPS = ("test_1", "test_2", "test_3")
"""Results are stated on these: people who walk, fight with a sword and wash a window."""
DURATION_S = 20.0

_TRUTH_FPS = 50.0
_SYNCHRONOUS = CameraTimes(fps=(30.0,))
_MIXED = CameraTimes(fps=(25.0, 30.0), random_phases=True)
_RADIUS_M, _HIGH_M, _LOW_M = 5.0, 2.7, 1.45
_TARGET_M = (0.0, 0.0, 0.9)
# Wide enough that a camera sees nearly all of the room, 6 x 6 m.
_FOCAL_PX, _SIZE_PX = 850.0, (1600, 1200)
# A table, and a cupboard that hides whoever is behind it.
_FURNITURE = (Furniture((-0.6, -0.4, 0.0), (0.6, 0.4, 0.75)), Furniture((1.5, 1.7, 0.0), (2.3, 2.1, 1.9)))
_TABLE = (Furniture((0.1, -0.5, 0.0), (1.3, 0.3, 0.75)),)
# A row of stools 0.7 m apart, back to the wall beside a door.
_SEATS = tuple(Seat((x_m, 1.6), -np.pi / 2) for x_m in (-2.1, -1.4, -0.7))


@dataclass(frozen=True)
class PeopleVariant:
    """How many people, and what makes them hard to tell apart."""

    name: str
    group: Group
    n_people: int
    n_cameras: int
    height_m: float = _HIGH_M
    """Of the cameras over the floor."""
    furniture: tuple[Furniture, ...] = ()
    times: CameraTimes = _SYNCHRONOUS
    seats: tuple[Seat, ...] = ()
    returning_share: float = CrowdPlan.returning_share
    """Of the people; the others sit down, as many as there are seats."""

    @property
    def description(self) -> str:
        """In a sentence without a full stop."""
        rates = " and ".join(f"{rate:g}" for rate in self.times.fps)
        clocks = f", {rates} Hz, each from a time of its own" if self.times.random_phases else f", {rates} Hz"
        among = " among a table and a cupboard" if self.furniture else ""
        among = " who sit beside one another in a room with a table" if self.seats else among
        return f"{self.n_people} people{among}, {self.n_cameras} cameras at {self.height_m:g} m{clocks}"


VARIANTS = (
    PeopleVariant("2_people_3_cameras", "high cameras", 2, 3),
    PeopleVariant("4_people_5_cameras", "high cameras", 4, 5),
    PeopleVariant("6_people_3_cameras", "high cameras", 6, 3),
    PeopleVariant("8_people_8_cameras", "high cameras", 8, 8),
    PeopleVariant("4_people_3_cameras_low", "low cameras", 4, 3, _LOW_M),
    PeopleVariant("4_people_5_cameras_low", "low cameras", 4, 5, _LOW_M),
    PeopleVariant("6_people_3_cameras_low", "low cameras", 6, 3, _LOW_M),
    PeopleVariant("8_people_5_cameras_low", "low cameras", 8, 5, _LOW_M),
    PeopleVariant("4_people_3_cameras_furniture", "furniture", 4, 3, furniture=_FURNITURE),
    PeopleVariant("4_people_5_cameras_low_furniture", "furniture", 4, 5, _LOW_M, furniture=_FURNITURE),
    PeopleVariant("4_people_5_cameras_unsynchronised", "unsynchronised", 4, 5, times=_MIXED),
    PeopleVariant("6_people_3_cameras_unsynchronised", "unsynchronised", 6, 3, times=_MIXED),
    PeopleVariant(
        "4_people_5_cameras_low_sitting", "sitting", 4, 5, _LOW_M, _TABLE, seats=_SEATS, returning_share=0.25
    ),
)


def find_variant(name: str) -> PeopleVariant:
    """A variant by name. Raises ValueError, which lists them, for an unknown one."""
    for variant in VARIANTS:
        if variant.name == name:
            return variant
    raise ValueError(f"no variant {name!r}; there is {', '.join(variant.name for variant in VARIANTS)}")


def group_of(variant: str) -> str:
    """The group of a variant by name; "others" for what is not of this benchmark."""
    return next((known.group for known in VARIANTS if known.name == variant), "others")


def recordings(
    variants: Iterable[PeopleVariant] = VARIANTS, clips: Iterable[str] = TEST_CLIPS, duration_s: float = DURATION_S
) -> Iterator[PeopleRecording]:
    """The recordings of the benchmark, one after the other; the same at each call. Raises ValueError as record()."""
    clips = tuple(clips)
    for variant in variants:
        for clip in clips:
            yield record(variant, clip, duration_s)


def record(variant: PeopleVariant, clip: str, duration_s: float = DURATION_S) -> PeopleRecording:
    """One recording.

    Raises:
        ValueError: the clip is none of TUNING_CLIPS and TEST_CLIPS.
    """
    if clip not in TUNING_CLIPS + TEST_CLIPS:
        raise ValueError(f"no clip {clip!r}; there is {', '.join(TUNING_CLIPS + TEST_CLIPS)}")
    # hash() of a string differs from process to process.
    seed = zlib.crc32(clip.encode())
    walks, works = ([embedded_motion(name) for name in names] for names in (_WALKS, _WORKS[clip.partition("_")[0]]))
    n_frames = int(duration_s * _TRUTH_FPS) + 1
    plan, furniture = CrowdPlan(returning_share=variant.returning_share), variant.furniture
    motion = crowd_motion(variant.n_people, n_frames, _TRUTH_FPS, walks, works, seed, plan, furniture, variant.seats)
    scene = simulate_crowd(motion, _rig(variant), DetectionNoise(), Occlusion(), CrowdErrors(), seed, variant.times)
    return PeopleRecording(clip, variant.name, scene)


def _rig(variant: PeopleVariant) -> CameraRig:
    return ring_rig(variant.n_cameras, _RADIUS_M, variant.height_m, _TARGET_M, _FOCAL_PX, _SIZE_PX)
