"""Triangulation of joints from several views: the initial guess where there is no per-view 3D, and a baseline."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.geometry.camera import CameraRig
from fgpose.geometry.vectors import norm
from fgpose.sampling import parts_of, spread_evenly

# Below this angle between all rays the depth of a point is not determined: 1 degree at 4 m and 5 px / 1145 px of
# detection error leaves a metre of depth error.
_MIN_PARALLAX_RAD = np.deg2rad(1.0)
_INLIER_PX = 20.0  # see CameraRig.in_own_px
USUAL_FROM_M = 4.0
"""Detectors err by lengths at the body: by 70 mm now and then, which is the angle of fusion.inlier_px at this distance.
At 1 m that angle is 17 mm."""
_NEAR_M = 3.0  # from here on the angle alone counts: it is 52 mm
_NEAREST_M = 0.5  # nobody is whole in the image of a camera so near: rays that meet there do so by chance
_MAX_PAIRS = 66  # all pairs of 12 views; bounds time and memory, which grow with pairs times views
_MAX_SHARED_PAIRS = 78  # of 13 views, of which 66 remain without one of them
_PROPOSALS_AT_ONCE = 12_000  # of four views they take about 12 MB
_FARTHEST_PX = 1e30  # of sixth powers, as in a determinant, double precision has no more


@dataclass(frozen=True, eq=False)
class Triangulation:
    """Points triangulated from the views that agree."""

    positions_m: Float[np.ndarray, "*points 3"]
    """World frame; NaN where fewer than two views agree or their rays are nearly parallel."""
    inliers: Bool[np.ndarray, "*points camera"]
    """The views whose detection lies within the threshold of the projected point."""


def triangulate(
    points2d_px: Float[np.ndarray, "*points camera 2"],
    weights: Float[np.ndarray, "*points camera"],
    projection_matrices: Float[np.ndarray, "*#points camera 3 4"],
) -> Float[np.ndarray, "*points 3"]:
    """Weighted linear triangulation (DLT), twice: the second pass divides each view's equations by its depth, which
    makes them pixels (Hartley and Sturm 1997, "iterative linear").

    Args:
        points2d_px: undistorted pixels; NaN = missing, and so is what no image holds, beyond 1e30.
        weights: information of each view relative to the others; 0 = leave out.
        projection_matrices: K [R|t] of each camera, the same for all points or not.

    Returns:
        World points in metres, NaN where fewer than two views have a point or all rays are parallel.
    """
    shape, n_views = points2d_px.shape[:-2], points2d_px.shape[-2]
    if projection_matrices.ndim > 3:
        projection_matrices = np.broadcast_to(projection_matrices, (*shape, n_views, 3, 4))
    # All points side by side: with the coordinates inside, numpy takes several times as long.
    across, weights, matrices = (
        np.ascontiguousarray(array.T)
        for array in (
            points2d_px.reshape(-1, n_views, 2),
            weights.reshape(-1, n_views),
            projection_matrices.reshape(-1, n_views, 3, 4),
        )
    )
    known = (np.abs(across) < _FARTHEST_PX).all(axis=0) & (weights > 0)
    rows = np.where(known, np.where(known, across, 0.0) * matrices[:, 2, None] - matrices[:, :2], 0.0)
    information = np.where(known, weights, 0.0)
    enough = known.sum(axis=0) >= 2
    positions_m = _solve(rows, information / (matrices[:3, 0] ** 2).sum(axis=0), enough)
    depths_m = (matrices[:3, 2] * positions_m[:, None]).sum(axis=0) + matrices[3, 2]
    usable = enough & np.isfinite(positions_m).all(axis=0)
    # A view within 1 mm of the point, which no image is in focus at, would outweigh all others.
    depths_m = np.where(np.abs(depths_m) > 1e-3, depths_m, 1e-3)
    return _solve(rows, np.where(usable, information / depths_m**2, 0.0), usable).T.reshape(*shape, 3)


def _solve(
    rows: Float[np.ndarray, "4 2 camera point"],
    information: Float[np.ndarray, "camera point"],
    usable: Bool[np.ndarray, " point"],
) -> Float[np.ndarray, "3 point"]:
    """Least squares of rows @ (X, 1) = 0 with one weight per view, by the normal equations in closed form."""
    flat, weighted = rows.reshape(4, -1, rows.shape[-1]), (rows * information).reshape(4, -1, rows.shape[-1])
    normal = np.einsum("irn,jrn->ijn", flat[:3], weighted)
    (a, b, c), (_, d, e), (_, _, f) = normal[:, :3]
    aa, bb, cc, dd, ee, ff = d * f - e * e, c * e - b * f, b * e - c * d, a * f - c * c, b * c - a * e, a * d - b * b
    determinant = a * aa + b * bb + c * cc
    # Relative to the scale of the matrix: rays that are parallel to 1e-6 give about 1e-12.
    determinant[~(usable & (determinant > 1e-12 * (a + d + f) ** 3))] = np.nan
    adjugate = np.array([[aa, bb, cc], [bb, dd, ee], [cc, ee, ff]])
    return np.einsum("ijn,jn->in", adjugate, normal[:, 3]) / -determinant


def triangulate_robust(
    undistorted_px: Float[np.ndarray, "*frames camera joint 2"],
    confidence: Float[np.ndarray, "*frames camera joint"],
    rig: CameraRig,
    inlier_px: float | Float[np.ndarray, "*#frames camera #joint"] | None = None,
    *,
    usual_from_m: float = 0.0,
) -> Triangulation:
    """Confidence-weighted DLT over the best subset of views; holds when a minority of views is grossly wrong.

    Every pair of views proposes a point; the proposal with the largest sum of confidences within the threshold wins
    (MSAC: nearer counts more), and its inliers are triangulated together.

    Args:
        inlier_px: the threshold, in pixels of each image; None: the default of fusion.inlier_px.
        usual_from_m: where no two views agree, points that are nearer to a camera have another threshold in its image:
            the length that inlier_px is at this depth. Points 3 m away and farther have not.

    Returns:
        Triangulation with shapes (*frames, joint, 3) and (*frames, joint, camera).
    """
    points_px, weights = undistorted_px.swapaxes(-3, -2), confidence.swapaxes(-2, -1)
    inlier_px = rig.in_own_px(_INLIER_PX) if inlier_px is None else inlier_px
    inlier_px = np.broadcast_to(inlier_px, confidence.shape).swapaxes(-2, -1)
    agreed = _agreed(points_px, weights, rig, inlier_px, 0.0)
    if usual_from_m > 0:
        without = np.isnan(agreed.positions_m).any(axis=-1) & ((weights > 0).sum(axis=-1) >= 2)
        if without.any():
            near = _agreed(points_px[without], weights[without], rig, inlier_px[without], usual_from_m)
            agreed.positions_m[without], agreed.inliers[without] = near.positions_m, near.inliers
    return agreed


def triangulate_without_each(
    undistorted_px: Float[np.ndarray, "frame camera joint 2"],
    confidence: Float[np.ndarray, "frame camera joint"],
    rig: CameraRig,
    inlier_px: Float[np.ndarray, "camera 1"],
) -> Float[np.ndarray, "camera frame joint 3"]:
    """triangulate_robust of all views but one, for each of them: what a pair proposes serves all the others.

    The same to rounding for up to 13 views; of more, other pairs propose.
    """
    points_px, weights = undistorted_px.swapaxes(-3, -2), confidence.swapaxes(-2, -1)
    inlier_px = np.broadcast_to(inlier_px, confidence.shape).swapaxes(-2, -1)
    pairs = _pairs(rig.n_cameras, _MAX_SHARED_PAIRS)
    found_m = np.full((rig.n_cameras, *weights.shape[:-1], 3), np.nan)
    if rig.n_cameras < 3:
        return found_m
    at_once = max(1, _PROPOSALS_AT_ONCE // max(1, weights.shape[1] * len(pairs)))
    for part in parts_of(len(weights), at_once):
        found_m[:, part] = _without_each(points_px[part], weights[part], rig, inlier_px[part], pairs)
    return found_m


def _without_each(
    points_px: Float[np.ndarray, "*points camera 2"],
    weights: Float[np.ndarray, "*points camera"],
    rig: CameraRig,
    inlier_px: Float[np.ndarray, "*points camera"],
    pairs: Int[np.ndarray, "pair 2"],
) -> Float[np.ndarray, "camera *points 3"]:
    proposals_m = triangulate(points_px[..., pairs, :], weights[..., pairs], rig.projection_matrices[pairs])
    support, inliers = _support(proposals_m, points_px, weights, rig, inlier_px, 0.0)
    scores, found_m = np.sum(support, axis=-1), np.full((rig.n_cameras, *weights.shape[:-1], 3), np.nan)
    for c in range(rig.n_cameras):
        others = np.flatnonzero((pairs != c).all(axis=-1))
        best = others[np.argmax(scores[..., others] - support[..., others, c], axis=-1)]
        among_others = _at_pair(inliers, best) & (np.arange(rig.n_cameras) != c)
        found_m[c] = _of_inliers(among_others, points_px, weights, rig).positions_m
    return found_m


def _agreed(
    points_px: Float[np.ndarray, "*points camera 2"],
    weights: Float[np.ndarray, "*points camera"],
    rig: CameraRig,
    inlier_px: Float[np.ndarray, "*points camera"],
    usual_from_m: float,
) -> Triangulation:
    """Of the best pair of views of each point, part by part; the angle counts nearer than usual_from_m as a length."""
    shape, pairs = weights.shape[:-1], _pairs(rig.n_cameras)
    n_proposals = math.prod(shape) * len(pairs)
    if 0 < n_proposals <= _PROPOSALS_AT_ONCE:
        return _of_best_pair(points_px, weights, rig, inlier_px, pairs, usual_from_m)
    found = Triangulation(np.full((*shape, 3), np.nan), np.zeros(weights.shape, dtype=bool))
    at_once = max(1, _PROPOSALS_AT_ONCE * shape[0] // max(1, n_proposals))
    for start in range(0, shape[0] if n_proposals else 0, at_once):
        part = slice(start, start + at_once)
        agreed = _of_best_pair(points_px[part], weights[part], rig, inlier_px[part], pairs, usual_from_m)
        found.positions_m[part], found.inliers[part] = agreed.positions_m, agreed.inliers
    return found


def _of_best_pair(
    points_px: Float[np.ndarray, "*points camera 2"],
    weights: Float[np.ndarray, "*points camera"],
    rig: CameraRig,
    inlier_px: Float[np.ndarray, "*points camera"],
    pairs: Int[np.ndarray, "pair 2"],
    usual_from_m: float,
) -> Triangulation:
    proposals_m = triangulate(points_px[..., pairs, :], weights[..., pairs], rig.projection_matrices[pairs])
    support, inliers = _support(proposals_m, points_px, weights, rig, inlier_px, usual_from_m)
    best = np.argmax(np.sum(support, axis=-1), axis=-1)
    return _of_inliers(_at_pair(inliers, best), points_px, weights, rig)


def _at_pair(
    inliers: Bool[np.ndarray, "*points pair camera"], best: Int[np.ndarray, "*points"]
) -> Bool[np.ndarray, "*points camera"]:
    return np.take_along_axis(inliers, best[..., None, None], axis=-2)[..., 0, :]


def _of_inliers(
    inliers: Bool[np.ndarray, "*points camera"],
    points_px: Float[np.ndarray, "*points camera 2"],
    weights: Float[np.ndarray, "*points camera"],
    rig: CameraRig,
) -> Triangulation:
    positions_m = triangulate(points_px, np.where(inliers, weights, 0.0), rig.projection_matrices)
    determined = inliers.sum(axis=-1) >= 2
    determined &= parallax_rad(positions_m, inliers, rig) >= _MIN_PARALLAX_RAD
    return Triangulation(np.where(determined[..., None], positions_m, np.nan), inliers & determined[..., None])


@cache
def _pairs(n_cameras: int, at_most: int = _MAX_PAIRS) -> Int[np.ndarray, "pair 2"]:
    """All pairs of views; of a large rig so many of them, spread evenly."""
    pairs = np.array(list(combinations(range(n_cameras), 2)), dtype=int).reshape(-1, 2)
    return pairs[spread_evenly(len(pairs), at_most)] if len(pairs) else pairs


def _support(
    proposals_m: Float[np.ndarray, "*points pair 3"],
    points_px: Float[np.ndarray, "*points camera 2"],
    weights: Float[np.ndarray, "*points camera"],
    rig: CameraRig,
    inlier_px: Float[np.ndarray, "*points camera"],
    usual_from_m: float,
) -> tuple[Float[np.ndarray, "*points pair camera"], Bool[np.ndarray, "*points pair camera"]]:
    """What each view adds to the MSAC score of the point that each pair of views proposes, and whether it is an
    inlier."""
    # Coordinate by coordinate: with the coordinates inside, numpy takes several times as long.
    x, y, depth_m = (proposals_m @ row[:, :3].T + row[:, 3] for row in rig.projection_matrices.swapaxes(0, 1))
    depth_m[~(depth_m > 0)] = np.nan
    threshold_px = inlier_px[..., None, :]
    if usual_from_m > 0:
        wider = np.maximum(usual_from_m / np.maximum(depth_m, _NEAREST_M), 1.0)
        threshold_px = threshold_px * np.where(depth_m < _NEAR_M, wider, 1.0)
    x, y = x / depth_m - points_px[..., None, :, 0], y / depth_m - points_px[..., None, :, 1]
    error = (x**2 + y**2) / threshold_px**2
    inliers = (error < 1.0) & (weights > 0)[..., None, :]
    return np.where(inliers, weights[..., None, :] * (1.0 - np.where(inliers, error, 1.0)), 0.0), inliers


def parallax_rad(
    positions_m: Float[np.ndarray, "*points 3"], used: Bool[np.ndarray, "*points camera"], rig: CameraRig
) -> Float[np.ndarray, "*points"]:
    """Largest angle between the rays of the used views, as lines; 0 where there are fewer than two."""
    centres_m = rig.positions_m
    rays = positions_m[..., None, :] - centres_m
    rays = rays / norm(rays)[..., None]
    cosine = np.abs(np.einsum("...ai,...bi->...ab", rays, rays))
    both = used[..., :, None] & used[..., None, :]
    smallest = np.min(np.where(both & np.isfinite(cosine), cosine, 1.0), axis=(-2, -1))
    return np.arccos(np.clip(smallest, 0.0, 1.0))


def parallaxes_deg(positions_m: Float[np.ndarray, "*points 3"], rig: CameraRig) -> Float[np.ndarray, " known_point"]:
    """Of all cameras, at the points that are known."""
    known_m = positions_m[np.isfinite(positions_m).all(axis=-1)]
    return np.rad2deg(parallax_rad(known_m, np.ones((len(known_m), rig.n_cameras), dtype=bool), rig))


def usual_parallax_deg(positions_m: Float[np.ndarray, "*points 3"], rig: CameraRig) -> float:
    """Of all cameras, the median over the points that are known; NaN where none is."""
    apart_deg = parallaxes_deg(positions_m, rig)
    return float(np.median(apart_deg)) if len(apart_deg) else np.nan
