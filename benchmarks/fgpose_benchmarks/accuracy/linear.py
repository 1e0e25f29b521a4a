"""What is usual without an estimator: triangulation frame by frame, and a low-pass filter over it."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float

from fgpose.estimation.initial_guess import fill_gaps
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.triangulation import triangulate

# More iterations take longer. Beyond 2 px a view counts less; a larger threshold trusts the worst of the inliers
# more.
_REFINE_ITERATIONS = 10
_HUBER_PX = 2.0
# Order and cut-off of Pose2Sim's default filter.
_FILTER_ORDER = 4
_CUTOFF_HZ = 6.0
_PADDING = 9  # frames of odd continuation at the ends, scipy's default for this order


def triangulate_ransac(
    undistorted_px: Float[np.ndarray, "frame camera joint 2"], rig: CameraRig, threshold_px: float = 30.0
) -> Float[np.ndarray, "frame joint 3"]:
    """RANSAC over the pairs of views, refined on its inliers: the baseline of Iskakov et al. (2019).

    As in their published code, each pair proposes a point by DLT; its inliers are the pair and all views within the
    threshold. The largest set of inliers is triangulated together, and its reprojection error (Huber) is minimised.
    Their code draws ten pairs at random and takes the first of several largest sets; here all pairs are tried, and the
    one with the smallest error is taken. Their threshold of 15 applies to half the distance in pixels: 30 px.

    Returns:
        World frame, metres; NaN where fewer than two views have the joint.
    """
    points_px = undistorted_px.swapaxes(1, 2)
    known = np.asarray(np.isfinite(points_px).all(axis=-1))
    most, chosen = np.full(known.shape[:2], -np.inf), np.zeros_like(known)
    for pair in map(list, combinations(range(rig.n_cameras), 2)):
        proposal_m = triangulate(points_px[..., pair, :], np.ones((*known.shape[:2], 2)), rig.projection_matrices[pair])
        error = _errors_px(proposal_m, points_px, rig) / threshold_px
        inliers = known & (error < 1.0)
        inliers[..., pair] |= known[..., pair]
        # Less than one view's worth, so that the error decides between sets of one size only.
        penalty = np.where(inliers, np.minimum(np.nan_to_num(error, nan=1.0), 1.0) ** 2, 0.0).mean(axis=-1)
        count = np.where(known[..., pair].all(axis=-1), inliers.sum(axis=-1) - 0.99 * penalty, -np.inf)
        chosen = np.where((count > most)[..., None], inliers, chosen)
        most = np.maximum(most, count)
    start_m = triangulate(points_px, chosen.astype(float), rig.projection_matrices)
    return _refined_m(start_m, points_px, chosen, rig)


def _errors_px(
    positions_m: Float[np.ndarray, "frame joint 3"],
    points_px: Float[np.ndarray, "frame joint camera 2"],
    rig: CameraRig,
) -> Float[np.ndarray, "frame joint camera"]:
    return np.linalg.norm(rig.project(positions_m).swapaxes(1, 2) - points_px, axis=-1)


def _refined_m(
    positions_m: Float[np.ndarray, "frame joint 3"],
    points_px: Float[np.ndarray, "frame joint camera 2"],
    used: Bool[np.ndarray, "frame joint camera"],
    rig: CameraRig,
) -> Float[np.ndarray, "frame joint 3"]:
    """Reprojection error (Huber) of the used views minimised: "iterative linear" triangulation, reweighted.

    Dividing each view's equations by its depth makes them pixels, so DLT with Huber's weights is its fixed point.
    """
    for _ in range(_REFINE_ITERATIONS):
        error_px = _errors_px(positions_m, points_px, rig)
        weights = np.where(used, _HUBER_PX / np.maximum(error_px, _HUBER_PX), 0.0)
        # A point behind one of its views has no error there: it stays where it is.
        stays = np.asarray((used & ~np.isfinite(error_px)).any(axis=-1))
        moved_m = triangulate(points_px, np.nan_to_num(weights), rig.projection_matrices)
        positions_m = np.where(stays[..., None], positions_m, moved_m)
    return positions_m


def low_pass(
    positions_m: Float[np.ndarray, "frame joint 3"], fps: float, cutoff_hz: float = _CUTOFF_HZ
) -> Float[np.ndarray, "frame joint 3"]:
    """Zero-lag Butterworth filter of 4th order (2nd order, forward and backward), as Pose2Sim's default.

    Gaps are interpolated linearly, and at the ends the nearest known position holds; a joint that is never known stays
    NaN.
    """
    from scipy.signal import butter, sosfiltfilt

    filled_m = fill_gaps(positions_m, np.arange(len(positions_m)) / fps)
    if len(filled_m) < 2:
        return filled_m
    sections = butter(_FILTER_ORDER // 2, cutoff_hz, fs=fps, output="sos")
    return np.asarray(sosfiltfilt(sections, filled_m, axis=0, padlen=min(_PADDING, len(filled_m) - 1)))
