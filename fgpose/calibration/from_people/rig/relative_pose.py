"""The pose of one camera relative to another, from all joints over time.

The five-point method within a robust estimator, on several subsets of the frames; what the network sees in 3D joins in
as one more proposal. Joints near a plane or in one place have several solutions of almost the same error, so that
several are returned, each at the minimum that it leads to. Which is right is for other views to tell, or for the 3D.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import gtsam
import numpy as np
from jaxtyping import Float

from fgpose.assessment.rigs import angle_deg
from fgpose.geometry.epipolar_distance import essential_matrix, sampson_errors

LEAST_POINTS = 30
"""That two cameras see in common; fewer do not tell how they stand to each other."""
_RUNS = 8
_MAX_POINTS = 1500  # for each proposal; thrice as many change no result by a tenth of its error
_SHARE = 0.5  # of the frames for each run
_CONFIDENCE = 0.999
_MAX_ITERATIONS = 2000  # at 30 % inliers the five-point method needs 2,800 for the confidence, at 40 % 670
# Minima that are nearer to each other than this are one: several times the error of either.
_SAME_DEG = 4.0
_LEAST_IN_FRONT = 0.7


@dataclass(frozen=True, eq=False)
class RelativePose:
    """Where a second camera may be, seen from the first."""

    first_T_second: Float[np.ndarray, "4 4"]
    """Of unit translation."""
    cost: float
    """Mean of the robust loss of the epipolar (Sampson) errors, at most 1."""
    in_front: float
    """Share of the joints that lie in front of both cameras."""
    cross_check_deg: float
    """Between its rotation and that of the views' 3D; NaN without 3D."""


def relative_poses(
    first: Float[np.ndarray, "frame joint 2"],
    second: Float[np.ndarray, "frame joint 2"],
    tolerance: float,
    from_3d: Float[np.ndarray, "4 4"] | None,
    rng: np.random.Generator,
) -> list[RelativePose]:
    """Candidates, the one with the least error first.

    Args:
        first, second: undistorted points at unit focal length; NaN = missing.
        tolerance: error of a good point in these units.
        from_3d: first_T_second of the views' 3D (procrustes_pose), or None.
        rng: draws the subsets.

    Returns:
        An empty list where both cameras see too little at the same time.
    """
    known = np.asarray(np.isfinite(first).all(axis=-1) & np.isfinite(second).all(axis=-1))
    if known.sum() < LEAST_POINTS:
        return []
    judged = _some(known, rng)
    points = first[judged], second[judged]
    found: list[RelativePose] = []
    for proposal in _proposals(first, second, known, tolerance, from_3d, rng):
        candidate = _polished(proposal, *points, tolerance, from_3d)
        same = [other for other in found if _are_same(other, candidate)]
        if candidate.in_front < _LEAST_IN_FRONT or any(other.cost <= candidate.cost for other in same):
            continue
        found = [other for other in found if other not in same] + [candidate]
    return sorted(found, key=lambda candidate: candidate.cost)


def _proposals(
    first: Float[np.ndarray, "frame joint 2"],
    second: Float[np.ndarray, "frame joint 2"],
    known: np.ndarray,
    tolerance: float,
    from_3d: Float[np.ndarray, "4 4"] | None,
    rng: np.random.Generator,
) -> Iterator[Float[np.ndarray, "4 4"]]:
    """first_T_second of each run."""
    import cv2

    if from_3d is not None and np.linalg.norm(from_3d[:3, 3]) > 0:
        yield from_3d
    n_frames = len(known)
    for run in range(_RUNS):
        drawn = rng.random(n_frames) < (1.0 if run == 0 else _SHARE)
        used = _some(known & drawn[:, None], rng)
        if used.sum() < LEAST_POINTS:
            continue
        pair = np.ascontiguousarray(first[used]), np.ascontiguousarray(second[used])
        E, inliers = cv2.findEssentialMat(*pair, np.eye(3), cv2.USAC_MAGSAC, _CONFIDENCE, tolerance, _MAX_ITERATIONS)
        if E is None or E.shape != (3, 3):
            continue
        _, R, t, _ = cv2.recoverPose(E, *pair, np.eye(3), mask=inliers.copy())
        yield _inverse(R, t[:, 0])


def _polished(
    first_T_second: Float[np.ndarray, "4 4"],
    first: Float[np.ndarray, "point 2"],
    second: Float[np.ndarray, "point 2"],
    tolerance: float,
    from_3d: Float[np.ndarray, "4 4"] | None,
) -> RelativePose:
    """The minimum of the robust Sampson errors that is nearest."""
    from scipy.optimize import least_squares

    R, t = first_T_second[:3, :3], first_T_second[:3, 3] / np.linalg.norm(first_T_second[:3, 3])
    across = np.linalg.svd(t[None])[2][1:]

    def pose(step: Float[np.ndarray, " 5"]) -> Float[np.ndarray, "4 4"]:
        moved, first_T_second = t + step[3:] @ across, np.eye(4)
        first_T_second[:3, :3] = R @ gtsam.Rot3.Expmap(step[:3]).matrix()
        first_T_second[:3, 3] = moved / np.linalg.norm(moved)
        return first_T_second

    def errors(step: Float[np.ndarray, " 5"]) -> Float[np.ndarray, " point"]:
        return sampson_errors(essential_matrix(pose(step)), second, first)

    best = least_squares(errors, np.zeros(5), loss="cauchy", f_scale=tolerance, x_scale=0.1, max_nfev=30)
    polished, squared = pose(best.x), (errors(best.x) / tolerance) ** 2
    depths = _depths(polished[:3, :3], polished[:3, 3], first, second)
    in_front, behind = ((sign * depths > 0).all(axis=0).mean() for sign in (1, -1))
    polished[:3, 3] *= 1 if in_front >= behind else -1
    return RelativePose(
        polished,
        cost=float(np.mean(np.minimum(squared, 1.0))),
        in_front=float(max(in_front, behind)),
        cross_check_deg=np.nan if from_3d is None else angle_deg(polished[:3, :3], from_3d[:3, :3]),
    )


def _depths(
    R: Float[np.ndarray, "3 3"],
    t: Float[np.ndarray, " 3"],
    first: Float[np.ndarray, "point 2"],
    second: Float[np.ndarray, "point 2"],
) -> Float[np.ndarray, "2 point"]:
    """Of the points along the rays of both cameras where they are nearest to each other: a x - R b y = t."""
    a, b = _rays(first), _rays(second) @ R.T
    aa, ab, bb = (np.sum(one * other, axis=1) for one, other in ((a, a), (a, b), (b, b)))
    at, bt = a @ t, b @ t
    determinant = np.maximum(aa * bb - ab**2, 1e-12)
    return np.stack([bb * at - ab * bt, ab * at - aa * bt]) / determinant


def _are_same(one: RelativePose, other: RelativePose) -> bool:
    directions = one.first_T_second[:3, 3] @ other.first_T_second[:3, 3]
    apart_deg = float(np.rad2deg(np.arccos(np.clip(directions, -1.0, 1.0))))
    return max(apart_deg, angle_deg(one.first_T_second[:3, :3], other.first_T_second[:3, :3])) < _SAME_DEG


def _some(known: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """At most _MAX_POINTS of the points that are known."""
    some = np.zeros(known.size, dtype=bool)
    places = np.flatnonzero(known)
    some[places if len(places) <= _MAX_POINTS else rng.choice(places, _MAX_POINTS, replace=False)] = True
    return some.reshape(known.shape)


def _inverse(R: Float[np.ndarray, "3 3"], t: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "4 4"]:
    inverse = np.eye(4)
    inverse[:3, :3], inverse[:3, 3] = R.T, -R.T @ t
    return inverse


def _rays(points: Float[np.ndarray, "point 2"]) -> Float[np.ndarray, "point 3"]:
    return np.concatenate([points, np.ones((len(points), 1))], axis=1)
