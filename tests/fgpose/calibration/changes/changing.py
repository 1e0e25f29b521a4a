"""Walkers with the errors of real detectors, filmed by cameras of which one changes while it films."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import gtsam
import numpy as np
from scipy.interpolate import CubicSpline

import fgpose
from fgpose.geometry.camera import CameraRig
from fgpose_benchmarks.synthetic import (
    NO_OCCLUSION,
    DetectionNoise,
    crowd_motion,
    embedded_motion,
    real_errors,
    ring_rig,
    simulate,
)

FPS = 30.0
SKELETON = fgpose.load_skeleton("h36m_17")
RIG = ring_rig(4, 5.0, 2.5, (0.0, 0.0, 0.9), focal_px=900.0, size_px=(1600, 1200))


@cache
def walk_m(seed: int, duration_s: float = 24.0) -> np.ndarray:
    """Somebody who walks about in the middle of the rig."""
    kinds = [embedded_motion("cmu_02_01_short")], [embedded_motion("cmu_02_07_a"), embedded_motion("cmu_02_10")]
    return crowd_motion(1, int(duration_s * FPS), FPS, *kinds, seed=seed).truth_m[0]


def filmed(truth_m: np.ndarray, rig: CameraRig = RIG, seed: int = 5) -> fgpose.Observations:
    errors = real_errors(np.random.default_rng(seed), len(truth_m), rig.n_cameras, SKELETON, FPS, ("openpose",))
    return simulate(truth_m, SKELETON, rig, FPS, DetectionNoise(), NO_OCCLUSION, seed, None, errors).observations


def exchanged(seen: fgpose.Observations, c: int, other: fgpose.Observations, frames: slice) -> fgpose.Observations:
    """With what a camera saw in some frames of another recording."""
    points2d_px, confidence = seen.points2d_px.copy(), seen.confidence.copy()
    points2d_px[frames, c], confidence[frames, c] = other.points2d_px[frames, c], other.confidence[frames, c]
    return replace(seen, points2d_px=points2d_px, confidence=confidence)


def lost(seen: fgpose.Observations, c: int, at: int, number: int) -> fgpose.Observations:
    """A camera lost some frames, and those after them were numbered on."""
    points2d_px, confidence = seen.points2d_px.copy(), seen.confidence.copy()
    points2d_px[at:-number, c], confidence[at:-number, c] = points2d_px[at + number :, c], confidence[at + number :, c]
    points2d_px[-number:, c], confidence[-number:, c] = np.nan, 0.0
    return replace(seen, points2d_px=points2d_px, confidence=confidence)


def late(seen: fgpose.Observations, c: int, by: int) -> fgpose.Observations:
    """A camera whose images are numbered too high."""
    points2d_px, confidence = seen.points2d_px.copy(), seen.confidence.copy()
    points2d_px[:, c], confidence[:, c] = np.roll(points2d_px[:, c], by, 0), np.roll(confidence[:, c], by, 0)
    points2d_px[:by, c], confidence[:by, c] = np.nan, 0.0
    return replace(seen, points2d_px=points2d_px, confidence=confidence)


def slower(seen: fgpose.Observations, c: int, ratio: float, truth_m: np.ndarray) -> fgpose.Observations:
    """A camera whose images follow each other after more time than is said."""
    frames = np.arange(int((len(truth_m) - 1) / ratio))
    own = filmed(CubicSpline(np.arange(len(truth_m)), truth_m)(frames * ratio), seed=82)
    points2d_px, confidence = seen.points2d_px.copy(), seen.confidence.copy()
    points2d_px[:, c], confidence[:, c] = np.nan, 0.0
    points2d_px[frames, c], confidence[frames, c] = own.points2d_px[:, c], own.confidence[:, c]
    return replace(seen, points2d_px=points2d_px, confidence=confidence)


def moved_rig(c: int, degrees: float) -> CameraRig:
    """A camera was turned, and its tripod moved by 22 mm."""
    cameras = list(RIG.cameras)
    pose = cameras[c].world_T_camera.copy()
    pose[:3, :3] = pose[:3, :3] @ gtsam.Rot3.Ry(np.deg2rad(degrees)).matrix()
    pose[:3, 3] += [0.02, 0.01, 0.0]
    cameras[c] = replace(cameras[c], world_T_camera=pose)
    return CameraRig(tuple(cameras))


def bumped(seen: fgpose.Observations, c: int, degrees: float, at: int, truth_m: np.ndarray) -> fgpose.Observations:
    return exchanged(seen, c, filmed(truth_m, moved_rig(c, degrees)), slice(at, None))


def left_out(truth_m: np.ndarray, share: float, usual_length: float, seed: int) -> fgpose.Observations:
    """Cameras that take their images at different moments; of each this share is left out, so many in a row on average,
    as a computer does that is too slow."""
    rng, n_frames, late_s = np.random.default_rng(seed), len(truth_m), np.array([0.0, 0.007, 0.014, 0.016])
    seen, time_s = filmed(truth_m, seed=seed), np.arange(n_frames) / FPS
    at_m = [CubicSpline(time_s, truth_m)(time_s + late) for late in late_s]
    points2d_px = seen.points2d_px - RIG.project(truth_m)
    points2d_px += np.stack([RIG.project(own_m)[:, c] for c, own_m in enumerate(at_m)], axis=1)
    there = np.ones((n_frames, len(late_s)), dtype=bool)
    for own in there.T:
        at = 0
        while at < n_frames:
            first = at + rng.geometric(1 / usual_length)
            at = first + rng.geometric((1 - share) / (share * usual_length))
            own[first:at] = False
    return replace(
        seen,
        points2d_px=np.where(there[:, :, None, None], points2d_px, np.nan),
        confidence=np.where(there[:, :, None], seen.confidence, 0.0),
        time_s=time_s[:, None] + late_s,
    )
