"""Damage to who is seen, and to what the joints are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from fgpose.finding import Code
from fgpose_benchmarks.faults.damage import Damage, Damaged, some_camera, with_points, with_sides_exchanged
from fgpose_benchmarks.faults.in_time import away
from fgpose_benchmarks.faults.take import FPS, Take, motion

_ARM, _LEG = ("shoulder", "elbow", "wrist"), ("hip", "knee", "ankle")


def _sides(take: Take, rng: np.random.Generator) -> Damaged:
    """Left and right are exchanged in one camera, throughout."""
    c = some_camera(take, rng)
    return Damaged(take.rig, with_sides_exchanged(take.observations, c), take.truth_m, (take.rig.names[c],))


def _skeleton(take: Take, rng: np.random.Generator) -> Damaged:
    """The joints stand in the order of coco_17."""
    order = np.array([9, 10, 10, 10, 10, 11, 14, 12, 15, 13, 16, 4, 1, 5, 2, 6, 3])
    return _reordered(take, order)


def _reordered(take: Take, order: np.ndarray) -> Damaged:
    """With the joints of all cameras in another order."""
    seen = take.observations
    reordered = with_points(seen, seen.points2d_px[:, :, order], seen.confidence[:, :, order])
    return Damaged(take.rig, reordered, take.truth_m)


def _joints_exchanged(
    joints: tuple[str, str], sides: tuple[str, ...] = ("left", "right")
) -> Callable[[Take, np.random.Generator], Damaged]:
    """Two joints of an arm or a leg, in all cameras."""

    def inflict(take: Take, rng: np.random.Generator) -> Damaged:
        skeleton = take.observations.skeleton
        order = np.arange(skeleton.n_joints)
        for side in sides:
            first, second = (skeleton.index(f"{side}_{joint}") for joint in joints)
            order[[first, second]] = second, first
        return _reordered(take, order)

    return inflict


def _sides_of_limbs(joints: tuple[str, ...], *, everywhere: bool) -> Callable[[Take, np.random.Generator], Damaged]:
    """Left and right are exchanged of some joints, in one camera or in all."""

    def inflict(take: Take, rng: np.random.Generator) -> Damaged:
        cameras = range(take.rig.n_cameras) if everywhere else (some_camera(take, rng),)
        seen = take.observations
        for c in cameras:
            seen = with_sides_exchanged(seen, c, joints)
        return Damaged(take.rig, seen, take.truth_m, () if everywhere else (take.rig.names[cameras[0]],))

    return inflict


def _other_person(take: Take, rng: np.random.Generator) -> Damaged:
    """One camera's keypoints are of somebody else, who is somewhere else."""
    c = some_camera(take, rng)
    other_m = motion("cmu_03_03_b", take.seed + 1000, len(take.truth_m) / FPS)
    n_frames = min(len(other_m), len(take.truth_m))
    other = take.film(take.rig, other_m[:n_frames])
    points, confidence = take.observations.points2d_px.copy(), take.observations.confidence.copy()
    points[:, c], confidence[:, c] = np.nan, 0.0
    points[:n_frames, c], confidence[:n_frames, c] = other.points2d_px[:, c], other.confidence[:, c]
    return Damaged(take.rig, with_points(take.observations, points, confidence), take.truth_m, (take.rig.names[c],))


def _beside(take: Take, rng: np.random.Generator) -> Damaged:
    """Two cameras follow somebody beside the person for a third of the time."""
    cameras, third = rng.choice(take.rig.n_cameras, 2, replace=False), len(take.truth_m) // 3
    beside_m = take.truth_m[::-1] + 1.5 * _some_direction(rng)
    gone_over = np.zeros(take.observations.confidence.shape[:2], dtype=bool)
    gone_over[third : 2 * third, cameras] = True
    return _gone_over(take, beside_m, gone_over)


def _passes(take: Take, rng: np.random.Generator) -> Damaged:
    """Two cameras go over for two seconds to somebody who passes the person, each where the two meet in its images."""
    cameras, middle, second = rng.choice(take.rig.n_cameras, 2, replace=False), len(take.truth_m) // 2, int(FPS)
    other_m = take.truth_m[::-1]
    passes_m = (
        other_m + np.mean(take.truth_m[middle] - other_m[middle], axis=0) * (1, 1, 0) + 0.5 * _some_direction(rng)
    )
    apart_px = np.linalg.norm(np.mean(take.rig.project(passes_m) - take.rig.project(take.truth_m), axis=2), axis=-1)
    gone_over = np.zeros(apart_px.shape, dtype=bool)
    for c in cameras:
        meet = middle - second + int(np.nanargmin(apart_px[middle - second : middle + second, c]))
        gone_over[meet : meet + 2 * second, c] = True
    return _gone_over(take, passes_m, gone_over)


def _some_direction(rng: np.random.Generator) -> np.ndarray:
    """Level."""
    angle = rng.uniform(0, 2 * np.pi)
    return np.array([np.cos(angle), np.sin(angle), 0.0])


def _gone_over(take: Take, other_m: np.ndarray, gone_over: np.ndarray) -> Damaged:
    """These images show somebody else."""
    seen, other = take.observations, take.film(take.rig, other_m)
    points = np.where(gone_over[..., None, None], other.points2d_px, seen.points2d_px)
    confidence = np.where(gone_over[..., None], other.confidence, seen.confidence)
    names = tuple(take.rig.names[c] for c in np.flatnonzero(gone_over.any(axis=0)))
    at_s = float(np.argmax(gone_over.any(axis=1))) / FPS
    return Damaged(take.rig, with_points(seen, points, confidence), take.truth_m, names, at_s)


def _reflection(take: Take, rng: np.random.Generator) -> Damaged:
    """One camera's network takes the reflection in a window for the person, half of the time."""
    c, n = some_camera(take, rng), len(take.truth_m)
    mirror = take.observations.skeleton.mirror
    reflected_m = (take.truth_m * np.array([1.0, -1.0, 1.0]) + np.array([0.0, 4.0, 0.0]))[:, mirror]
    taken = np.zeros(take.observations.confidence.shape[:2], dtype=bool)
    taken[:, c] = np.repeat(rng.random(n // 15 + 1) < 0.5, 15)[:n]
    return replace(_gone_over(take, reflected_m, taken), at_s=None)


def _nobody(take: Take, rng: np.random.Generator) -> Damaged:
    """Nobody is there for a fifth at the beginning, in the middle, and at the end."""
    n = len(take.truth_m)
    frame = np.arange(n)
    gone = (frame < n // 5) | ((frame >= 2 * n // 5) & (frame < 3 * n // 5)) | (frame >= 4 * n // 5)
    points = np.where(gone[:, None, None, None], np.nan, take.observations.points2d_px)
    return Damaged(take.rig, with_points(take.observations, points), away(take.truth_m, gone))


def _somebody_else(take: Take, rng: np.random.Generator) -> Damaged:
    """From the middle on it is somebody of 0.65 times the size, somewhere else."""
    middle = len(take.truth_m) // 2
    small_m = 0.65 * (take.truth_m + np.array([0.6, -0.4, 0.0]))
    small = take.film(take.rig, small_m)
    points, confidence = take.observations.points2d_px.copy(), take.observations.confidence.copy()
    points[middle:], confidence[middle:] = small.points2d_px[middle:], small.confidence[middle:]
    points[middle : middle + 30] = np.nan
    truth_m = away(take.truth_m, (np.arange(len(points)) >= middle) & (np.arange(len(points)) < middle + 30))
    truth_m[middle + 30 :] = small_m[middle + 30 :]
    return Damaged(take.rig, with_points(take.observations, points, confidence), truth_m)


def _legs(take: Take, rng: np.random.Generator) -> Damaged:
    """Legs that are not in any image: a network puts them straight down, with little confidence."""
    joints = take.observations.skeleton.joints
    hallucinated_m = take.truth_m.copy()
    for side in ("left", "right"):
        hip, knee, ankle = (joints.index(f"{side}_{name}") for name in ("hip", "knee", "ankle"))
        hallucinated_m[:, knee] = hallucinated_m[:, hip] + (0.25, 0.1, -0.30)
        hallucinated_m[:, ankle] = hallucinated_m[:, knee] + (0.0, 0.0, -0.30)
    legs = [joints.index(f"{side}_{name}") for side in ("left", "right") for name in ("knee", "ankle")]
    shown = take.film(take.rig, hallucinated_m)
    points, confidence = take.observations.points2d_px.copy(), take.observations.confidence.copy()
    points[:, :, legs] = shown.points2d_px[:, :, legs]
    confidence[:, :, legs] = np.clip(rng.normal(0.05, 0.03, confidence[:, :, legs].shape), 0.01, 1.0)
    return Damaged(take.rig, with_points(take.observations, points, confidence), take.truth_m)


def _alone(take: Take, rng: np.random.Generator) -> Damaged:
    """All cameras but one stop in the middle."""
    c, middle = some_camera(take, rng), len(take.truth_m) // 2
    points = take.observations.points2d_px.copy()
    others = [other for other in range(take.rig.n_cameras) if other != c]
    points[middle:, others] = np.nan
    return Damaged(take.rig, with_points(take.observations, points), take.truth_m, at_s=middle / FPS)


def _hallucinating(take: Take, rng: np.random.Generator) -> Damaged:
    """A camera's network sees somebody in a coat stand: always the same, with some noise."""
    c = some_camera(take, rng)
    points = take.observations.points2d_px.copy()
    ever = np.isfinite(points[:, c]).all(axis=-1).any(axis=0)
    stand_px = np.nanmedian(points[:, c, ever], axis=0) + rng.uniform(-300, 300, 2)
    points[:, c, ever] = stand_px + rng.normal(0, 3.0, points[:, c, ever].shape)
    return Damaged(take.rig, with_points(take.observations, points), take.truth_m, (take.rig.names[c],))


PEOPLE: tuple[Damage, ...] = (
    Damage("left and right exchanged, one camera", (Code.EXCHANGED_SIDES,), _sides, is_constant=True),
    Damage("joints in another order", (Code.WRONG_SKELETON,), _skeleton, is_constant=True, of_simulated=True),
    Damage(
        "elbows and wrists exchanged", (Code.WRONG_SKELETON,), _joints_exchanged(("elbow", "wrist")), is_constant=True
    ),
    Damage(
        "left knee and ankle exchanged",
        (Code.WRONG_SKELETON,),
        _joints_exchanged(("knee", "ankle"), ("left",)),
        is_constant=True,
    ),
    Damage(
        "somebody else's keypoints, one camera",
        (Code.OTHER_PERSON, Code.WRONG_CAMERA),
        _other_person,
        3,
        is_constant=True,
        of_simulated=True,
    ),
    Damage(
        "somebody beside for a while, two cameras",
        (Code.IDENTITY_SWITCH, Code.DISAGREEING_CAMERA),
        _beside,
        4,
        of_simulated=True,
    ),
    Damage(
        "somebody passes, two cameras",
        (Code.IDENTITY_SWITCH, Code.DISAGREEING_CAMERA),
        _passes,
        4,
        of_simulated=True,
    ),
    Damage(
        "a reflection now and then, one camera",
        (Code.OTHER_PERSON, Code.IDENTITY_SWITCH, Code.DISAGREEING_CAMERA),
        _reflection,
        3,
        of_simulated=True,
    ),
    Damage("legs left for right", (Code.EXCHANGED_SIDES,), _sides_of_limbs(_LEG, everywhere=True), is_constant=True),
    Damage("arms left for right", (Code.EXCHANGED_SIDES,), _sides_of_limbs(_ARM, everywhere=True), is_constant=True),
    Damage(
        "legs left for right, one camera",
        (Code.EXCHANGED_SIDES,),
        _sides_of_limbs(_LEG, everywhere=False),
        is_constant=True,
    ),
    Damage(
        "arms left for right, one camera",
        (Code.EXCHANGED_SIDES,),
        _sides_of_limbs(_ARM, everywhere=False),
        is_constant=True,
    ),
    Damage("nobody for most of the time", (Code.NOBODY,), _nobody),
    Damage("somebody else from the middle on", (Code.SOMEBODY_ELSE,), _somebody_else),
    Damage("legs out of the images", (Code.LOW_CONFIDENCE,), _legs, is_constant=True, of_simulated=True),
    Damage("one camera alone", (Code.FEW_CAMERAS, Code.BLIND_CAMERA, Code.GAP), _alone),
    Damage(
        "a coat stand",
        (
            Code.THING_FOR_PERSON,
            Code.HALLUCINATING_CAMERA,
            Code.FROZEN_CAMERA,
            Code.OTHER_PERSON,
            Code.WRONG_CAMERA,
        ),
        _hallucinating,
        3,
        is_constant=True,
    ),
)
