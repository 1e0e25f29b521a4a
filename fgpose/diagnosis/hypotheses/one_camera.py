"""A camera that disagrees with others that agree, where no known cause explains it: what is left to be told."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from enum import Enum
from itertools import combinations
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from fgpose.calibration.large_moves import BUMP_DEG, BUMP_M
from fgpose.diagnosis.hypotheses.consistency import STEADY, consistency, unsteadiness
from fgpose.diagnosis.hypotheses.scene import CameraView, SynchronousViews
from fgpose.geometry.rigid import pose_of

# Half of the rays of a camera that agrees pass the joints of the others by less (state.NORMAL_M).
_FITS_M = 0.07
_STRETCHES = 8  # of the time, each judged by itself
_LEAST_JOINTS = 20
# Of clocks: by how much they may differ, in which steps, and how far somebody has to move in a stretch to tell.
_MOST_S, _STEP_S, _MOVES_M = 30.0, 0.1, 0.15
# Of 24, 25, 30, 50, 60, 100 and 120 Hz one over another. The first ones fit at first even if they are not looked for.
_NEAR_RATES = (1.2, 5 / 6, 1.25, 0.8)
_RATES = (2.0, 0.5, 4.0, 0.25, *_NEAR_RATES, 2.4, 1 / 2.4, 2.5, 0.4, 5 / 3, 0.6)
_STARTS_S = 0.5
_PAIR_REACH_S, _PAIR_FRAMES = 5.0, 120  # of every pair where none is known to be right
_ALIKE = 0.4  # correlation of the same motion in two views; of two motions it is around 0
_LEAST_SIGMA_M = 1e-3  # keypoints without errors, as of simulations, agree exactly
_RANSAC_PX = 30.0  # in images of a focal length of 1000 px: 0.12 m at 4 m


class Why(Enum):
    """Why a camera disagrees."""

    FOR_A_WHILE = "agrees for some of the time: it was moved, lost images, or shows somebody else at times"
    CLOCK = "sees the same at another time"
    RATE = "sees the same, but faster or slower"
    POSE = "stands elsewhere than the calibration says"
    DISTORTED = "sees the same motion, but elsewhere"
    UNKNOWN = "sees something else"


class OddCamera(NamedTuple):
    why: Why
    rate: float = 1.0
    """Where it is another one: by how many times as fast the images show the motion as their stamps say."""
    rotation_deg: float = np.nan
    """Where it stands elsewhere: by how much it would have to be turned and moved."""
    translation_m: float = np.nan


def why_odd(sample: SynchronousViews, dense: SynchronousViews, camera: int, others: tuple[int, ...]) -> OddCamera:
    """What sets a camera apart from others that agree.

    Args:
        sample: frames spread over the whole recording.
        dense: frames so near to each other that clocks can be compared.
        camera: the one that disagrees.
        others: at least two that agree.
    """
    dense_view, dense_m = dense.views[camera], consistency(dense.cameras(others)).positions_m
    rate = _rate_that_fits(dense_view, dense_m, dense.time_s, _NEAR_RATES, _STRETCHES // 2)
    if rate is not None:
        return OddCamera(Why.RATE, rate=rate)
    agreed = consistency(sample.cameras(others))
    view, joints_m = sample.views[camera], agreed.positions_m
    if _fits_for_a_while(_missed_m(view, joints_m)):
        return OddCamera(Why.FOR_A_WHILE)
    if _fits_at_another_time(dense_view, dense_m, dense.time_s):
        return OddCamera(Why.CLOCK)
    rate = _rate_that_fits(dense_view, dense_m, dense.time_s, _RATES, 2)
    if rate is not None:
        return OddCamera(Why.RATE, rate=rate)
    pose = _pose_that_fits(view, joints_m, agreed.median_m)
    if pose is None:
        return OddCamera(Why.DISTORTED if _moves_alike(dense_view, dense_m) else Why.UNKNOWN)
    move = np.linalg.inv(view.camera.world_T_camera) @ pose
    cosine = np.clip((np.trace(move[:3, :3]) - 1) / 2, -1, 1)
    rotation_deg, translation_m = float(np.rad2deg(np.arccos(cosine))), float(np.linalg.norm(move[:3, 3]))
    return OddCamera(Why.POSE, rotation_deg=rotation_deg, translation_m=translation_m)


def clocks_differ(dense: SynchronousViews) -> bool:
    """Whether every camera agrees with some other one at another time: most stretches in which the body moves fit."""
    fits = np.eye(dense.n_cameras, dtype=bool)
    for a, b in combinations(range(dense.n_cameras), 2):
        fits[a, b] = fits[b, a] = _pair_fits_at_another_time(dense.cameras((a, b)))
    return bool((fits.sum(axis=1) >= 2).all())


def _pair_fits_at_another_time(pair: SynchronousViews) -> bool:
    reach_s, n_frames = min(_PAIR_REACH_S, float(np.ptp(pair.time_s)) / 2), len(pair.time_s)
    some = np.linspace(0, n_frames - 1, min(n_frames, _PAIR_FRAMES)).round().astype(int)
    best, shifts_s = np.full(_STRETCHES, np.inf), np.arange(-reach_s, reach_s + _STEP_S / 2, 2 * _STEP_S)
    for shift_s in shifts_s.tolist():
        other = _at_other_times(pair.views[1], pair.time_s, pair.time_s[some] + shift_s)
        shifted = replace(pair, views=(pair.views[0].frames(some), other), time_s=pair.time_s[some])
        found = consistency(shifted)
        steady = unsteadiness(found.positions_m, pair.limbs) < STEADY
        if steady:
            best = np.fmin(best, _medians(found.distance_m.max(axis=-1)))
    moves = _spread_m(consistency(pair.frames(some)).positions_m) > _MOVES_M
    return moves and float(np.mean(best[np.isfinite(best)] < _FITS_M / 2)) > 0.6 if np.isfinite(best).any() else False


def _missed_m(view: CameraView, joints_m: Float[np.ndarray, "frame joint 3"]) -> Float[np.ndarray, "frame joint"]:
    """By how much the rays of a view pass joints; NaN where either is missing."""
    offset_m = joints_m - view.camera.position_m
    depth_m = np.sum(offset_m * view.rays, axis=-1)
    across_m = np.sqrt(np.maximum(np.sum(offset_m**2, axis=-1) - depth_m**2, 0.0))
    return np.where(np.isnan(depth_m) | (depth_m > 0), across_m, np.inf)


def _medians(missed_m: Float[np.ndarray, "frame joint"]) -> Float[np.ndarray, " stretch"]:
    """Of stretches of time; NaN where there is too little."""
    parts = [part[~np.isnan(part)] for part in np.array_split(missed_m, _STRETCHES)]
    return np.array([np.median(part) if len(part) >= _LEAST_JOINTS else np.nan for part in parts])


def _fits_for_a_while(missed_m: Float[np.ndarray, "frame joint"]) -> bool:
    return bool(np.sum(_medians(missed_m) < _FITS_M) >= 2)


def _fits_at_another_time(
    view: CameraView, joints_m: Float[np.ndarray, "frame joint 3"], time_s: Float[np.ndarray, " frame"]
) -> bool:
    """Whether most of the stretches in which somebody moves fit at some other time, be it another one for each."""
    reach_s = min(_MOST_S, float(time_s[-1] - time_s[0]) / 2)
    moves = np.array([_spread_m(part) > _MOVES_M for part in np.array_split(joints_m, _STRETCHES)])
    best = np.full(_STRETCHES, np.inf)
    for shift_s in np.arange(-reach_s, reach_s + _STEP_S / 2, _STEP_S).tolist():
        best = np.fmin(best, _medians(_missed_m(_at_other_times(view, time_s, time_s + shift_s), joints_m)))
    judged = moves & np.isfinite(best)
    return int(judged.sum()) >= 2 and float(np.mean(best[judged] < _FITS_M)) > 0.6


def _rate_that_fits(
    view: CameraView,
    joints_m: Float[np.ndarray, "frame joint 3"],
    time_s: Float[np.ndarray, " frame"],
    rates: Iterable[float],
    fewest: int,
) -> float | None:
    """The usual rate that was taken for another usual one, if most of so many stretches or more fit with it, all with
    the same start."""
    moves = np.array([_spread_m(part) > _MOVES_M for part in np.array_split(joints_m, _STRETCHES)])
    for rate in rates:
        for start_s in np.arange(-_STARTS_S, _STARTS_S + _STEP_S / 2, _STEP_S).tolist():
            stamps_s = time_s[0] + (time_s - time_s[0] - start_s) / rate
            missed_m = _medians(_missed_m(_at_other_times(view, time_s, stamps_s), joints_m))
            judged = moves & np.isfinite(missed_m)
            if judged.sum() >= fewest and np.mean(missed_m[judged] < _FITS_M) > 0.6:
                return rate
    return None


def _spread_m(joints_m: Float[np.ndarray, "frame joint 3"]) -> float:
    """How far joints move, root mean square; 0 where they are not known."""
    known = np.asarray(np.isfinite(joints_m).all(axis=-1))
    tracks_m = [joints_m[known[:, j], j] for j in range(known.shape[1]) if known[:, j].sum() > 1]
    moved_m = [np.sqrt(np.mean(np.sum((each - each.mean(axis=0)) ** 2, axis=-1))) for each in tracks_m]
    return float(np.median(moved_m)) if moved_m else 0.0


def _at_other_times(
    view: CameraView, time_s: Float[np.ndarray, " frame"], wanted_s: Float[np.ndarray, " wanted"]
) -> CameraView:
    """The nearest frames; nothing beyond the ends."""
    after = np.clip(np.searchsorted(time_s, wanted_s), 1, len(time_s) - 1)
    frames = np.where(wanted_s - time_s[after - 1] < time_s[after] - wanted_s, after - 1, after)
    shifted = view.frames(frames)
    outside = (wanted_s < time_s[0]) | (wanted_s > time_s[-1])
    shifted.__dict__["in_camera"] = np.where(outside[:, None, None], np.nan, shifted.in_camera)
    return shifted


def _moves_alike(view: CameraView, joints_m: Float[np.ndarray, "frame joint 3"]) -> bool:
    """Whether the image moves as the joints of the others do: of half of the joints that move, correlated."""
    expected = joints_m - view.camera.position_m
    expected = expected / np.linalg.norm(expected, axis=-1, keepdims=True)
    found = []
    for j in range(joints_m.shape[1]):
        known = np.isfinite(expected[:, j]).all(axis=-1) & np.isfinite(view.rays[:, j]).all(axis=-1)
        if known.sum() >= _LEAST_JOINTS:
            a, b = (each[known, j] - np.median(each[known, j], axis=0) for each in (expected, view.rays))
            found.append(float(np.sum(a * b) / np.sqrt(np.sum(a**2) * np.sum(b**2) + 1e-12)))
    return bool(found) and float(np.median(found)) > _ALIKE


def _pose_that_fits(
    view: CameraView, joints_m: Float[np.ndarray, "frame joint 3"], sigma_m: float
) -> Float[np.ndarray, "4 4"] | None:
    """From the stretches with even numbers, if those with odd ones agree; joints are known to so much."""
    import cv2

    known = np.isfinite(joints_m).all(axis=-1) & np.isfinite(view.in_camera).all(axis=-1)
    known &= view.in_camera[..., 2] > 0.1
    stretch = np.arange(len(joints_m)) * _STRETCHES // len(joints_m)
    used = known & (stretch % 2 == 0)[:, None]
    if used.sum() < _LEAST_JOINTS or (known & ~used).sum() < _LEAST_JOINTS:
        return None
    image = 1000 * view.in_camera[used][:, :2] / view.in_camera[used][:, 2:]
    K = np.diag([1000.0, 1000.0, 1.0])
    cv2.setRNGSeed(0)
    found, rotation, t_m, _ = cv2.solvePnPRansac(
        joints_m[used], image, K, None, iterationsCount=300, reprojectionError=_RANSAC_PX, flags=cv2.SOLVEPNP_EPNP
    )
    if not found:
        return None
    camera_T_world = pose_of(cv2.Rodrigues(rotation)[0], t_m.ravel())
    for pose in (_least_moved(view, joints_m, used, camera_T_world, sigma_m), np.linalg.inv(camera_T_world)):
        held_out = _missed_m(view.at(pose), joints_m)[known & ~used]
        if np.median(held_out) < _FITS_M:
            return pose
    return None


def _least_moved(
    view: CameraView,
    joints_m: Float[np.ndarray, "frame joint 3"],
    used: Bool[np.ndarray, "frame joint"],
    camera_T_world: Float[np.ndarray, "4 4"],
    sigma_m: float,
) -> Float[np.ndarray, "4 4"]:
    """The most probable pose, where bumps are the more probable the smaller they are: somebody who hardly leaves the
    middle of the image tells turns and moves to the side hardly apart, and what the others are wrong by makes one look
    like the other. Joints of one stretch of time are wrong alike: it counts as two measurements, however many."""
    from scipy.optimize import least_squares
    from scipy.spatial.transform import Rotation

    given = view.camera.camera_T_world
    points_m, seen = joints_m[used], view.in_camera[used][:, :2] / view.in_camera[used][:, 2:]
    weight, sigma_m = np.sqrt(_STRETCHES / len(points_m)), max(sigma_m, _LEAST_SIGMA_M)

    def errors(change: Float[np.ndarray, " 6"]) -> Float[np.ndarray, " residual"]:
        in_camera = Rotation.from_rotvec(change[:3]).apply(points_m @ given[:3, :3].T + given[:3, 3]) + change[3:]
        depth_m = np.maximum(in_camera[:, 2:], 0.1)
        missed_m = depth_m * (in_camera[:, :2] / depth_m - seen)
        length_m = np.linalg.norm(missed_m, axis=-1)
        robust = np.sqrt(2 * (np.sqrt(1 + (length_m / sigma_m) ** 2) - 1))  # pseudo-Huber
        bump = np.array([np.linalg.norm(change[:3]) / np.deg2rad(BUMP_DEG), np.linalg.norm(change[3:]) / BUMP_M])
        return np.concatenate([weight * robust, np.sqrt(np.log1p(bump**2))])  # Cauchy: another place may be any

    fitted = camera_T_world @ np.linalg.inv(given)
    starts = (np.zeros(6), np.concatenate([Rotation.from_matrix(fitted[:3, :3]).as_rotvec(), fitted[:3, 3]]))
    change = min((least_squares(errors, start) for start in starts), key=lambda found: found.cost).x
    return np.linalg.inv(pose_of(Rotation.from_rotvec(change[:3]).as_matrix(), change[3:]) @ given)
