"""What a detector makes of the true pixels, most of it constant in metres at the joint's depth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from fgpose.skeleton import Skeleton
from fgpose_benchmarks.random_recordings.conditions import Conditions
from fgpose_benchmarks.synthetic.noise import MIN_CONFIDENCE, correlated_normal

# Chosen: no detector was measured.
_JOINTS_DIFFER = 0.4
_BODY_S = 0.3
_T_FREEDOM = 3
_ADRIFT_M, _ADRIFT_S = 0.12, 0.6
_TOWARDS, _TOWARDS_M, _TOWARDS_S = 0.6, 0.05, 0.5
_BACKGROUND_PX = 2.0
_SWAPPED_EVERY_S = 4.0
_OUTLIER_M = 0.3
_CONFIDENT, _CONFIDENCE_FALL_PER_M, _CONFIDENCE_SIGMA, _HIDDEN_SIGMA = 0.85, 2.0, 0.08, 0.05
_SMALL = 0.25
_NEAREST_M = 0.1

_LIMBS = (("elbow", "wrist"), ("knee", "ankle"))
_ARM, _LEG = ("shoulder", "elbow", "wrist"), ("hip", "knee", "ankle")


@dataclass(frozen=True, eq=False)
class TrueViews:
    """Where the joints really are in the images."""

    points_px: Float[np.ndarray, "frame camera joint 2"]
    """As the lens shows them."""
    px_per_m: Float[np.ndarray, "frame camera joint"]
    depth_m: Float[np.ndarray, "frame camera joint"]


@dataclass(frozen=True, eq=False)
class Detections:
    points_px: Float[np.ndarray, "frame camera joint 2"]
    confidence: Float[np.ndarray, "frame camera joint"]
    hidden: Bool[np.ndarray, "frame camera joint"]
    """From the camera; what a detector says of it is invented."""
    wrong: Bool[np.ndarray, "frame camera joint"]
    """Hidden, of the other side, or outliers."""


def detections(views: TrueViews, skeleton: Skeleton, conditions: Conditions, rng: np.random.Generator) -> Detections:
    """What one detector gives in each camera."""
    off_m = detection_error_m(views.depth_m.shape, conditions, rng)
    points_px = views.points_px + off_m * views.px_per_m[..., None]
    hidden = _hidden(views.depth_m.shape, skeleton, conditions, rng)
    points_px = np.where(hidden[..., None], _invented_px(points_px, views, hidden, conditions, rng), points_px)
    swapped, other = _swapped(views.depth_m.shape, skeleton, conditions, rng)
    points_px = np.where(swapped[..., None], points_px[:, :, other], points_px)
    points_px, outlier = with_outliers(points_px, views.px_per_m, conditions, rng)
    points_px = _within_image(points_px, views, conditions)
    dropped = rng.random(hidden.shape[:2]) < conditions.dropped_share
    missing = dropped[..., None] | ~(views.depth_m > _NEAREST_M)
    points_px = np.where(missing[..., None], np.nan, points_px)
    confidence = np.where(np.isfinite(points_px).all(axis=-1), stated_confidence(off_m, hidden, conditions, rng), 0.0)
    return Detections(points_px, confidence, hidden, hidden | swapped | outlier)


def with_outliers(
    points_px: Float[np.ndarray, "*joints 2"],
    px_per_m: Float[np.ndarray, "*#joints"],
    conditions: Conditions,
    rng: np.random.Generator,
) -> tuple[Float[np.ndarray, "*joints 2"], Bool[np.ndarray, "*joints"]]:
    """Detections of which some are off, on the grid of the detector, and which are off."""
    outlier = rng.random(points_px.shape[:-1]) < conditions.outlier_share
    far_px = _OUTLIER_M * rng.standard_normal(points_px.shape) * px_per_m[..., None]
    points_px = points_px + np.where(outlier[..., None], far_px, 0.0)
    if conditions.stride_px:
        points_px = np.round(points_px / conditions.stride_px) * conditions.stride_px
    return points_px, outlier


def detection_error_m(
    shape: tuple[int, ...], conditions: Conditions, rng: np.random.Generator
) -> Float[np.ndarray, "frame camera joint 2"]:
    """Of joints that are seen, at their depth, across the ray; by frame, camera and joint."""
    n_frames, n_cameras, n_joints = shape
    sigma_m = conditions.sigma_m * np.exp(rng.normal(0, _JOINTS_DIFFER, n_joints))
    alone = rng.standard_normal((*shape, 2))
    if conditions.heavy_tails:
        alone = rng.standard_t(_T_FREEDOM, (*shape, 2)) / np.sqrt(_T_FREEDOM)
    share = conditions.correlated_share
    slow = correlated_normal(rng, (*shape, 2), conditions.fps, conditions.correlation_s)
    bias_m = conditions.bias_m * rng.standard_normal((1, n_cameras, n_joints, 2))
    body_m = conditions.body_m * correlated_normal(rng, (n_frames, n_cameras, 1, 2), conditions.fps, _BODY_S)
    return (np.sqrt(1 - share) * alone + np.sqrt(share) * slow) * sigma_m[:, None] + bias_m + body_m


def switching(
    rng: np.random.Generator, shape: tuple[int, ...], fps: float, on_s: float, off_s: float
) -> Bool[np.ndarray, "*shape"]:
    """On and off in turn along the first axis (frames), each for a random time (exponential) of these means."""
    stays_on, stays_off = np.exp(-1 / (fps * on_s)), np.exp(-1 / (fps * off_s))
    drawn = rng.random(shape)
    on = drawn < on_s / (on_s + off_s)
    for frame in range(1, len(on)):
        on[frame] = np.where(on[frame - 1], drawn[frame] < stays_on, drawn[frame] >= stays_off)
    return on


def _hidden(
    shape: tuple[int, ...], skeleton: Skeleton, conditions: Conditions, rng: np.random.Generator
) -> Bool[np.ndarray, "frame camera joint"]:
    """Joints that belong together are hidden together."""
    n_frames, n_cameras, n_joints = shape
    together = {
        "nothing": [],
        "limbs": [
            [skeleton.joints.index(f"{side}_{joint}") for joint in limb]
            for side in ("left", "right")
            for limb in _LIMBS
        ],
        "left side": [[j for j, joint in enumerate(skeleton.joints) if joint.startswith("left")]],
        "whole body": [list(range(n_joints))],
        "joints": [[joint] for joint in range(n_joints)],
    }[conditions.hidden]
    hidden = np.zeros(shape, dtype=bool)
    for joints in together:
        now = switching(rng, (n_frames, n_cameras), conditions.fps, conditions.hidden_s, conditions.visible_s)
        hidden[:, :, joints] = now[..., None]
    return hidden


def _invented_px(
    points_px: Float[np.ndarray, "frame camera joint 2"],
    views: TrueViews,
    hidden: Bool[np.ndarray, "frame camera joint"],
    conditions: Conditions,
    rng: np.random.Generator,
) -> Float[np.ndarray, "frame camera joint 2"]:
    """Where a detector puts joints that it does not see."""

    def slow_px(sigma_m: float, constant_s: float) -> Float[np.ndarray, "frame camera joint 2"]:
        return sigma_m * views.px_per_m[..., None] * correlated_normal(rng, points_px.shape, conditions.fps, constant_s)

    match conditions.hidden_are:
        case "missing":
            return np.full_like(points_px, np.nan)
        case "adrift":
            return points_px + slow_px(_ADRIFT_M, _ADRIFT_S)
        case "frozen":
            held_px = points_px.copy()
            for frame in range(1, len(held_px)):
                held_px[frame] = np.where(hidden[frame][..., None], held_px[frame - 1], held_px[frame])
            return held_px
        case "towards the body":
            middle_px = views.points_px.mean(axis=2, keepdims=True)
            return points_px + _TOWARDS * (middle_px - points_px) + slow_px(_TOWARDS_M, _TOWARDS_S)
        case "in the background":
            place_px = rng.uniform(0, conditions.size_px, points_px.shape[1:])
            return place_px + _BACKGROUND_PX * rng.standard_normal(points_px.shape)
    raise AssertionError(conditions.hidden_are)


def _swapped(
    shape: tuple[int, ...], skeleton: Skeleton, conditions: Conditions, rng: np.random.Generator
) -> tuple[Bool[np.ndarray, "frame camera joint"], list[int]]:
    """Which detections are of the other side, and of which joint."""
    other = list(range(shape[2]))
    for left, right in skeleton.left_right:
        other[left], other[right] = right, left
    if not conditions.swapped_s:
        return np.zeros(shape, dtype=bool), other
    now = switching(rng, shape[:2], conditions.fps, conditions.swapped_s, _SWAPPED_EVERY_S)
    own = [other[joint] != joint and _is_swapped(name, conditions) for joint, name in enumerate(skeleton.joints)]
    return now[..., None] & np.array(own), other


def _is_swapped(joint: str, conditions: Conditions) -> bool:
    if conditions.swapped_are == "whole body":
        return True
    is_of_one = conditions.swapped_are != "both legs on one" or joint.startswith("right_")
    return is_of_one and joint.endswith(_ARM if conditions.swapped_are == "arms" else _LEG)


def _within_image(
    points_px: Float[np.ndarray, "frame camera joint 2"], views: TrueViews, conditions: Conditions
) -> Float[np.ndarray, "frame camera joint 2"]:
    size_px = np.array(conditions.size_px)
    if conditions.outside_are == "clamped":
        return np.clip(points_px, 0.0, size_px - 1.0)
    if conditions.outside_are == "missing":
        inside = np.asarray(((views.points_px >= 0) & (views.points_px < size_px)).all(axis=-1))
        return np.where(inside[..., None], points_px, np.nan)
    return points_px


def stated_confidence(
    error_m: Float[np.ndarray, "*joints 2"],
    hidden: Bool[np.ndarray, "*joints"],
    conditions: Conditions,
    rng: np.random.Generator,
) -> Float[np.ndarray, "*joints"]:
    """What the detector says of joints with these errors, and of those that are hidden."""
    if conditions.confidence == "one":
        return np.ones(hidden.shape)
    if conditions.confidence == "random":
        return rng.uniform(0.3, 1.0, hidden.shape)
    fallen = _CONFIDENT - _CONFIDENCE_FALL_PER_M * np.linalg.norm(error_m, axis=-1)
    visible = fallen + _CONFIDENCE_SIGMA * rng.standard_normal(hidden.shape)
    unseen = conditions.hidden_confidence + _HIDDEN_SIGMA * rng.standard_normal(hidden.shape)
    scale = _SMALL if conditions.confidence == "small" else 1.0
    return scale * np.clip(np.where(hidden, unseen, visible), MIN_CONFIDENCE, 1.0)
