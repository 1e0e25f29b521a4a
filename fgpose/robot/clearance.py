"""How far people are from shapes, at least: distances of capsules from capsules and boxes, less a quantile.

The quantile. A capsule of the robot and a box are convex, so all of a shape lies behind the plane through its point
nearest to the axis of a person's capsule, across the line between the two. The axis, a segment, is no nearer to the
shape than the nearer of its two ends is to that plane. The height of an end above the plane is linear in its position
and therefore normal with the standard deviation of the joint along that line, sigma:

    distance >= min over both ends of (height - z sigma) - radii

with z the normal quantile whose tail is 1 - quantile, halved where a capsule has two ends (Bonferroni's bound, whatever
the correlation of the ends). So the axis of each capsule is farther away than stated with at least the probability
`quantile`, if the joints are normal with the covariance stated. It is a statement on one capsule, not on all of them
at once. An end midway between two joints has at most the mean of their sigmas. Where the axis touches or enters a shape
there is no such line: the largest standard deviation is taken.
"""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from jaxtyping import Bool, Float

from fgpose.geometry.segments import nearest_on_segments

_TOUCHES_M = 1e-6  # nearer than this, rounding decides on the direction from the shape to the axis


@dataclass(frozen=True, eq=False)
class Axes:
    """Capsules of people in the world frame."""

    ends_m: Float[np.ndarray, "axis end=2 3"]
    covariance_m2: Float[np.ndarray, "axis end=2 half=2 3 3"]
    """Of the two joints midway between which each end lies."""
    radius_m: Float[np.ndarray, " axis"]
    is_sphere: Bool[np.ndarray, " axis"]


@dataclass(frozen=True, eq=False)
class Shapes:
    """Capsules and boxes of a robot or its surroundings; a sphere is a capsule without length."""

    capsule_ends_m: Float[np.ndarray, "capsule end=2 3"]
    capsule_radius_m: Float[np.ndarray, " capsule"]
    box_low_m: Float[np.ndarray, "box 3"]
    """Corners in the frame of each box."""
    box_high_m: Float[np.ndarray, "box 3"]
    world_T_box: Float[np.ndarray, "box 4 4"]
    """For capsules, which are given in the world frame, there is no such transform."""


@dataclass(frozen=True, eq=False)
class Clearance:
    """Of each axis from each shape, capsules first, then boxes, in metres; negative where they overlap."""

    expected_m: Float[np.ndarray, "axis shape"]
    """Between the surfaces where the joints are exactly where they are expected."""
    least_m: Float[np.ndarray, "axis shape"]
    """At least this with the probability asked for."""
    along: Float[np.ndarray, "axis shape"]
    """Where on the axis its nearest point lies, 0 to 1."""


def clearance(axes: Axes, shapes: Shapes, quantile: float) -> Clearance:
    """Distances of capsules of people from shapes, expected and at least; see the top of this module."""
    both_ends = 1.0 - (1.0 - quantile) / 2
    z = np.where(axes.is_sphere, NormalDist().inv_cdf(quantile), NormalDist().inv_cdf(both_ends))
    parts = [_from_capsules(axes, shapes)] + ([_from_boxes(axes, shapes)] if len(shapes.box_low_m) else [])
    expected, least, along = [], [], []
    for along_axis, nearest_m, depth_m, radius_m in parts:
        away_m = _away_m(axes, along_axis, nearest_m)
        distance_m = np.linalg.norm(away_m, axis=-1)
        height_m, sigma_m = _ends_above(axes, away_m, distance_m, nearest_m, depth_m)
        radii_m = axes.radius_m[:, None] + radius_m
        expected.append(distance_m - depth_m - radii_m)
        least.append((height_m - z[:, None, None] * sigma_m).min(axis=-1) - radii_m)
        along.append(along_axis)
    return Clearance(*(np.concatenate(columns, axis=1) for columns in (expected, least, along)))


_Nearest = tuple[
    Float[np.ndarray, "axis shape"],
    Float[np.ndarray, "axis shape 3"],
    Float[np.ndarray, "axis shape"],
    Float[np.ndarray, " shape"],
]
"""Where on the axis, the nearest point of the shape (of the axis of a capsule), how deep inside it, its radius."""


def _from_capsules(axes: Axes, shapes: Shapes) -> _Nearest:
    start_m, end_m = shapes.capsule_ends_m[:, 0], shapes.capsule_ends_m[:, 1]
    along, along_shape, _ = nearest_on_segments(axes.ends_m[:, None, 0], axes.ends_m[:, None, 1], start_m, end_m)
    nearest_m = start_m + along_shape[..., None] * (end_m - start_m)
    return along, nearest_m, np.zeros_like(along), shapes.capsule_radius_m


def _from_boxes(axes: Axes, shapes: Shapes) -> _Nearest:
    R, t_m = shapes.world_T_box[:, :3, :3], shapes.world_T_box[:, :3, 3]
    # Into the frame of each box: R^T (x - t), as rows.
    in_box_m = np.einsum("nebi,bij->nbej", axes.ends_m[:, :, None] - t_m, R)
    start_m, step_m = in_box_m[..., 0, :], in_box_m[..., 1, :] - in_box_m[..., 0, :]
    along = _nearest_to_box(start_m, step_m, shapes.box_low_m, shapes.box_high_m)
    point_m = start_m + along[..., None] * step_m
    nearest_m = np.clip(point_m, shapes.box_low_m, shapes.box_high_m)
    inside_m = np.minimum(point_m - shapes.box_low_m, shapes.box_high_m - point_m).min(axis=-1)
    nearest_in_world_m = np.einsum("nbj,bij->nbi", nearest_m, R) + t_m
    return along, nearest_in_world_m, np.maximum(inside_m, 0.0), np.zeros(len(t_m))


def _nearest_to_box(
    start_m: Float[np.ndarray, "axis box 3"],
    step_m: Float[np.ndarray, "axis box 3"],
    low_m: Float[np.ndarray, "box 3"],
    high_m: Float[np.ndarray, "box 3"],
) -> Float[np.ndarray, "axis box"]:
    """Where on each axis, start + along step, the squared distance from the box is least.

    It is quadratic between the places where the axis crosses the planes of the faces, so it is least in one of these
    pieces: where its derivative vanishes, or at an end of the piece. Of pieces inside the box the one with the deepest
    middle is taken.
    """
    safe_m = np.where(np.abs(step_m) < 1e-12, 1.0, step_m)
    crossings = [
        np.where(np.abs(step_m) < 1e-12, 0.0, np.clip((face_m - start_m) / safe_m, 0.0, 1.0))
        for face_m in (low_m, high_m)
    ]
    ends = np.zeros((*start_m.shape[:2], 1))
    cuts = np.sort(np.concatenate([ends, *crossings, ends + 1.0], axis=-1), axis=-1)
    first, last = cuts[..., :-1], cuts[..., 1:]
    middle_m = start_m[..., None, :] + (first + last)[..., None] / 2 * step_m[..., None, :]
    low_m, high_m = low_m[:, None], high_m[:, None]
    bound_m = np.where(middle_m < low_m, low_m, high_m)
    step_out_m = np.where((middle_m < low_m) | (middle_m > high_m), step_m[..., None, :], 0.0)
    slope = np.sum(step_out_m * (start_m[..., None, :] - bound_m), axis=-1)
    curvature = np.sum(step_out_m**2, axis=-1)
    is_flat = curvature < 1e-18
    lowest = np.clip(-slope / np.where(is_flat, 1.0, curvature), first, last)
    along = np.where(is_flat, (first + last) / 2, lowest)
    point_m = start_m[..., None, :] + along[..., None] * step_m[..., None, :]
    beyond_m = np.maximum(low_m - point_m, point_m - high_m)
    outside_m = np.linalg.norm(np.maximum(beyond_m, 0.0), axis=-1)
    best = np.argmin(np.where(outside_m > 0.0, outside_m, beyond_m.max(axis=-1)), axis=-1)
    return np.take_along_axis(along, best[..., None], axis=-1)[..., 0]


def _away_m(
    axes: Axes, along: Float[np.ndarray, "axis shape"], nearest_m: Float[np.ndarray, "axis shape 3"]
) -> Float[np.ndarray, "axis shape 3"]:
    """From the nearest point of the shape to that of the axis."""
    start_m, step_m = axes.ends_m[:, None, 0], axes.ends_m[:, None, 1] - axes.ends_m[:, None, 0]
    return start_m + along[..., None] * step_m - nearest_m


def _ends_above(
    axes: Axes,
    away_m: Float[np.ndarray, "axis shape 3"],
    distance_m: Float[np.ndarray, "axis shape"],
    nearest_m: Float[np.ndarray, "axis shape 3"],
    depth_m: Float[np.ndarray, "axis shape"],
) -> tuple[Float[np.ndarray, "axis shape end=2"], Float[np.ndarray, "axis shape end=2"]]:
    """Height of both ends above the plane between shape and axis, and its standard deviation."""
    touches = distance_m[..., None] < _TOUCHES_M
    normal = np.where(touches, 0.0, away_m / np.where(touches, 1.0, distance_m[..., None]))
    height_m = np.einsum("nsi,nsei->nse", normal, axes.ends_m[:, None] - nearest_m[:, :, None])
    variance_m2 = np.einsum("nsi,nehij,nsj->nseh", normal, axes.covariance_m2, normal)
    if touches.any():
        largest_m2 = np.linalg.eigvalsh(axes.covariance_m2)[..., -1]
        variance_m2 = np.where(touches[..., None], largest_m2[:, None], variance_m2)
    sigma_m = np.sqrt(np.maximum(variance_m2, 0.0)).sum(axis=-1) / 2
    return np.where(touches, -depth_m[..., None], height_m), sigma_m
