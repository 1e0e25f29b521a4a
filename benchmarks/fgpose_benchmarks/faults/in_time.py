"""Damage that changes with time: clocks, lost frames, bumps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from fgpose.finding import Code
from fgpose.geometry.camera import CameraRig
from fgpose_benchmarks.faults.damage import Damage, Damaged, some_camera, with_points
from fgpose_benchmarks.faults.geometry import nudge, of_points
from fgpose_benchmarks.faults.take import FPS, Take

_SHAKES_S = 0.4  # how long a hand takes to be elsewhere


def at_other_times(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Take, np.random.Generator], Damaged]:
    """One camera took its images at other times than its frames say.

    Args:
        change: from the times of the frames to the times of the images, seconds.
    """

    def inflict(take: Take, rng: np.random.Generator) -> Damaged:
        c = some_camera(take, rng)
        time_s = np.arange(len(take.truth_m)) / FPS
        taken_s = change(time_s)
        shown_m = CubicSpline(time_s, take.truth_m)(np.clip(taken_s, 0, time_s[-1]))
        filmed = take.film(take.rig, shown_m)
        inside = (taken_s >= 0) & (taken_s <= time_s[-1])
        points, confidence = take.observations.points2d_px.copy(), take.observations.confidence.copy()
        points[:, c] = np.where(inside[:, None, None], filmed.points2d_px[:, c], np.nan)
        confidence[:, c] = filmed.confidence[:, c]
        seen = with_points(take.observations, points, confidence)
        in_3d = {}
        for name in ("points3d_m", "covariance3d_m2"):
            given, new = getattr(seen, name), getattr(filmed, name)
            if given is not None and new is not None:
                in_3d[name] = given.copy()
                in_3d[name][:, c] = new[:, c]
        if "points3d_m" in in_3d:
            in_3d["points3d_m"][~inside, c] = np.nan
        seen = replace(seen, **in_3d)
        at_s = float(time_s[len(time_s) // 2])
        return Damaged(take.rig, seen, take.truth_m, (take.rig.names[c],), at_s)

    return inflict


def _lost(n_frames: int) -> Callable[[np.ndarray], np.ndarray]:
    """From the middle on, so many frames are missing and the others are numbered on."""
    return lambda time_s: time_s + np.where(time_s >= time_s[len(time_s) // 2], n_frames / FPS, 0.0)


def _now_and_then(time_s: np.ndarray) -> np.ndarray:
    """Images are missing at random, and the others are numbered on."""
    kept = np.random.default_rng(len(time_s)).random(len(time_s)) > 0.05
    taken_s = np.full(len(time_s), np.inf)
    taken_s[: kept.sum()] = time_s[kept]
    return taken_s


def bumped(degrees: float) -> Callable[[Take, np.random.Generator], Damaged]:
    """A camera that is turned, and moved by 2 cm, in the middle of the recording."""

    def inflict(take: Take, rng: np.random.Generator) -> Damaged:
        c = some_camera(take, rng)
        cameras = list(take.rig.cameras)
        cameras[c] = replace(cameras[c], world_T_camera=cameras[c].world_T_camera @ nudge(rng, degrees, 0.02))
        after = take.film(CameraRig(tuple(cameras)))
        middle = len(take.truth_m) // 2
        points, confidence = take.observations.points2d_px.copy(), take.observations.confidence.copy()
        points[middle:, c], confidence[middle:, c] = after.points2d_px[middle:, c], after.confidence[middle:, c]
        damaged = with_points(take.observations, points, confidence)
        return Damaged(take.rig, damaged, take.truth_m, (take.rig.names[c],), middle / FPS)

    return inflict


def _frozen(take: Take, rng: np.random.Generator) -> Damaged:
    """The images of a camera stop in the middle of the recording."""
    c, middle = some_camera(take, rng), len(take.truth_m) // 2
    points, confidence = take.observations.points2d_px.copy(), take.observations.confidence.copy()
    points[middle:, c], confidence[middle:, c] = points[middle, c], confidence[middle, c]
    damaged = with_points(take.observations, points, confidence)
    return Damaged(take.rig, damaged, take.truth_m, (take.rig.names[c],), middle / FPS)


def _each_image(n_times: int, *, everywhere: bool) -> Callable[[Take, np.random.Generator], Damaged]:
    """A video whose images were written several times, of one camera or of all."""

    def inflict(take: Take, rng: np.random.Generator) -> Damaged:
        c = slice(None) if everywhere else some_camera(take, rng)
        shown = np.arange(len(take.truth_m)) // n_times * n_times
        points, confidence = take.observations.points2d_px.copy(), take.observations.confidence.copy()
        points[:, c], confidence[:, c] = points[shown, c], confidence[shown, c]
        cameras = () if isinstance(c, slice) else (take.rig.names[c],)
        return Damaged(take.rig, with_points(take.observations, points, confidence), take.truth_m, cameras)

    return inflict


def _slower(factor: float) -> Callable[[Take, np.random.Generator], Damaged]:
    """Times that are so many times as long as they were, of all cameras."""

    def inflict(take: Take, rng: np.random.Generator) -> Damaged:
        given = replace(take.observations, time_s=factor * take.observations.frame_time_s)
        return Damaged(take.rig, given, take.truth_m, slower=factor)

    return inflict


def _interpolated(take: Take, rng: np.random.Generator) -> Damaged:
    """All cameras miss everybody for 0.6 s in every 2 s, and straight lines were put there."""
    points, n_gap = take.observations.points2d_px.copy(), round(0.6 * FPS)
    for first in range(round(FPS), len(points) - n_gap - 1, 2 * round(FPS)):
        before, after = points[first - 1], points[first + n_gap]
        share = (np.arange(1, n_gap + 1) / (n_gap + 1))[:, None, None, None]
        points[first : first + n_gap] = (1 - share) * before + share * after
    confidence = np.maximum(take.observations.confidence, 0.5)
    return Damaged(take.rig, with_points(take.observations, points, confidence), take.truth_m)


def _smoothed(sigma_s: float, *, one: bool) -> Callable[..., Damaged]:
    """A Gaussian filter over the keypoints of one camera or of all."""
    return of_points(lambda points, _: gaussian_filter1d(points, sigma_s * FPS, axis=0), one=one)


def _shaking(degrees: float, *, one: bool) -> Callable[[Take, np.random.Generator], Damaged]:
    """Images that move to and fro, as from a camera that is held in the hand, or one that is stabilised.

    Args:
        degrees: standard deviation about each axis.
        one: one camera, or all of them.
    """

    def inflict(take: Take, rng: np.random.Generator) -> Damaged:
        points = take.observations.points2d_px.copy()
        shaken = [some_camera(take, rng)] if one else range(take.rig.n_cameras)
        for c in shaken:
            noise = gaussian_filter1d(rng.normal(size=(len(points), 2)), _SHAKES_S * FPS, axis=0)
            angle = np.deg2rad(degrees) * noise / noise.std(axis=0)
            points[:, c] += (angle * np.diag(take.rig.cameras[c].K)[:2])[:, None]
        names = tuple(take.rig.names[c] for c in shaken) if one else ()
        return Damaged(take.rig, with_points(take.observations, points), take.truth_m, names)

    return inflict


IN_TIME: tuple[Damage, ...] = (
    Damage("late by 2 frames", (Code.LATE_CAMERA,), at_other_times(lambda t: t - 2 / FPS), 3),
    Damage("numbered from 1", (Code.LATE_CAMERA,), at_other_times(lambda t: t + 1 / FPS), 3),
    Damage("late by 1.3 s", (Code.LATE_CAMERA,), at_other_times(lambda t: t - 1.3), 3),
    Damage("6 frames lost", (Code.LOST_FRAMES,), at_other_times(_lost(6)), 3),
    Damage("2 frames lost", (Code.LOST_FRAMES,), at_other_times(_lost(2)), 3),
    Damage("half the rate", (Code.CLOCK_RATE,), at_other_times(lambda t: 2 * t), 3),
    Damage("0.5 % slower clock", (Code.CLOCK_RATE,), at_other_times(lambda t: 1.005 * t), 3),
    Damage("every twentieth frame lost", (Code.CLOCK_RATE, Code.LOST_FRAMES), at_other_times(_now_and_then), 3),
    Damage("numbers of frames as seconds", (Code.FRAME_RATE,), _slower(FPS), of_simulated=True),
    Damage("slow motion, eight times", (Code.FRAME_RATE,), _slower(8.0), of_simulated=True),
    Damage("bumped by 0.7 degrees", (Code.BUMPED_CAMERA,), bumped(0.7), 3),
    Damage("bumped by 2 degrees", (Code.BUMPED_CAMERA,), bumped(2.0), 3),
    Damage("shaking images", (Code.UNSTEADY_CAMERA,), _shaking(0.5, one=False)),
    Damage("shaking images, one camera", (Code.UNSTEADY_CAMERA,), _shaking(0.5, one=True), 3),
    Damage("frozen images", (Code.FROZEN_CAMERA,), _frozen),
    Damage("each image twice", (Code.REPEATED_IMAGES,), _each_image(2, everywhere=True), is_constant=True),
    Damage(
        "each image four times, one camera",
        (Code.REPEATED_IMAGES,),
        _each_image(4, everywhere=False),
        is_constant=True,
    ),
    Damage("gaps of 0.6 s interpolated", (Code.INTERPOLATED_KEYPOINTS,), _interpolated, is_constant=True),
    Damage(
        "smoothed by 0.4 s",
        (Code.SMOOTHED_KEYPOINTS,),
        _smoothed(0.4, one=False),
        is_constant=True,
        of_simulated=True,
    ),
    Damage(
        "smoothed by 0.2 s, one camera",
        (Code.SMOOTHED_KEYPOINTS,),
        _smoothed(0.2, one=True),
        is_constant=True,
        of_simulated=True,
    ),
)


def away(truth_m: Float[np.ndarray, "frame joint 3"], gone: np.ndarray) -> Float[np.ndarray, "frame joint 3"]:
    """NaN where nobody is there."""
    return np.where(gone[:, None, None], np.nan, truth_m)
