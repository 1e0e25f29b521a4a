"""Multi-view fusion of per-view 3D poses with per-joint weights (eq. 1-2 of the paper)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from fgpose.assessment.metrics import mean_known
from fgpose.config import Config, DepthConfig, FusionConfig
from fgpose.estimation.evidence.inputs import check_inputs
from fgpose.estimation.noise import surely_positive
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.triangulation import USUAL_FROM_M, triangulate_robust
from fgpose.observations import Observations
from fgpose.shown import Shown
from fgpose_factors import robust_weight

# Keeps 1/e of eq. 2 finite where all views agree exactly; no detector is right to 0.01 px (un-squared: 0.0001 px).
_MIN_ERROR = 1e-4
# After ten steps the mean moves by less than a millimetre (real recordings).
_MEAN_ITERATIONS = 10


@dataclass(frozen=True, eq=False, repr=False)
class Fusion(Shown):
    """The fused pose of every frame and how far each view can be trusted with each joint."""

    positions_m: Float[np.ndarray, "frame joint 3"]
    """World frame; NaN where no view has the joint."""
    weights: Float[np.ndarray, "frame camera joint"]
    """w of eq. 2, 1/px^2 (1/px when un-squared); 0 where the view has no candidate."""
    reprojection_px2: Float[np.ndarray, "frame camera joint"]
    """e of eq. 2: mean over the views of the squared reprojection error (un-squared: of its square root, px) of this
    view's candidate; NaN where there is none."""
    reprojection_by_view_px2: Float[np.ndarray, "frame candidate camera joint"]
    """The terms of that mean: the candidate of one view projected into every view."""


def fuse(observations: Observations, rig: CameraRig, config: Config | None = None) -> Fusion:
    """Weighted mean of the views' absolute 3D joints (eq. 1), weights from reprojection errors (eq. 2).

    A joint for which no view has 3D is triangulated robustly from its 2D points instead; each view's candidate is then
    that one point, and its weight comes from its own reprojection error.

    Raises:
        ValueError: the cameras of the observations and of the rig differ.
        TypeError: the observations are of several people, or the arguments are exchanged.
    """
    check_inputs("fuse", observations, rig)
    config = config or Config()
    observations.check_cameras(rig.names)
    undistorted_px = rig.undistort(observations.points2d_px)
    inlier_px = rig.in_own_px(config.fusion.inlier_px)
    triangulated = triangulate_robust(
        undistorted_px, observations.confidence, rig, inlier_px, usual_from_m=USUAL_FROM_M
    )
    return fuse_undistorted(observations, triangulated.positions_m, undistorted_px, rig, config)


def fuse_undistorted(
    observations: Observations,
    triangulated_m: Float[np.ndarray, "frame joint 3"],
    undistorted_px: Float[np.ndarray, "frame camera joint 2"],
    rig: CameraRig,
    config: Config,
) -> Fusion:
    """fuse for points that are undistorted and triangulated already."""
    points3d_m, covariance_m2 = observations.points3d_m, observations.covariance3d_m2
    if points3d_m is None:
        return _from_triangulation(triangulated_m, undistorted_px, rig, config.fusion)
    fused = _from_candidates(points3d_m, undistorted_px, rig, config.fusion)
    if config.fusion.mean == "covariance" and covariance_m2 is not None:
        mean_m = _robust_mean_m(points3d_m, covariance_m2, fused.positions_m, config.depth)
        fused = replace(fused, positions_m=mean_m)
    without_3d = np.asarray(np.isnan(fused.positions_m).any(axis=-1))
    if not without_3d.any():
        return fused
    filler = _from_triangulation(triangulated_m, undistorted_px, rig, config.fusion)
    at_camera = without_3d[:, None]
    return Fusion(
        np.where(without_3d[..., None], filler.positions_m, fused.positions_m),
        np.where(at_camera, filler.weights, fused.weights),
        np.where(at_camera, filler.reprojection_px2, fused.reprojection_px2),
        np.where(at_camera[:, None], filler.reprojection_by_view_px2, fused.reprojection_by_view_px2),
    )


def _from_candidates(
    points3d_m: Float[np.ndarray, "frame camera joint 3"],
    undistorted_px: Float[np.ndarray, "frame camera joint 2"],
    rig: CameraRig,
    config: FusionConfig,
) -> Fusion:
    squared_px2 = np.sum((rig.project(points3d_m) - undistorted_px[:, None]) ** 2, axis=-1)
    term = squared_px2 if config.exponent == "squared" else np.sqrt(squared_px2)
    error = mean_known(term, axis=2)
    # A candidate that no view can check (its only detection is missing) still counts if it is the only one: like one
    # with an error of inlier_px, the largest error of an inlier.
    known = np.asarray(np.isfinite(points3d_m).all(axis=-1))
    checked = known & np.isfinite(error)
    unchecked_only = known & ~checked.any(axis=1, keepdims=True)
    unchecked_error = config.inlier_px**2 if config.exponent == "squared" else config.inlier_px
    weights = np.where(checked, _reciprocal(error), 0.0)
    weights = np.where(unchecked_only, 1.0 / unchecked_error, weights)
    total = weights.sum(axis=1)[..., None]
    weighted = np.where(known[..., None], points3d_m, 0.0) * weights[..., None]
    positions_m = np.divide(
        weighted.sum(axis=1), total, out=np.full((*total.shape[:-1], 3), np.nan), where=total > 0
    )  # eq. 1
    return Fusion(positions_m, weights, error, squared_px2)


def _reciprocal(error: Float[np.ndarray, "*candidates"]) -> Float[np.ndarray, "*candidates"]:
    """w = 1 / e of eq. 2."""
    return 1.0 / np.maximum(error, _MIN_ERROR)


def _robust_mean_m(
    points3d_m: Float[np.ndarray, "frame camera joint 3"],
    covariance_m2: Float[np.ndarray, "frame camera joint 3 3"],
    start_m: Float[np.ndarray, "frame joint 3"],
    config: DepthConfig,
) -> Float[np.ndarray, "frame joint 3"]:
    """Mean of the views' points by their covariances, by iterated reweighting with the kernel of their depths."""
    known = np.asarray(np.isfinite(covariance_m2).all(axis=(-1, -2)))[..., None, None]
    information = np.where(known, np.linalg.inv(surely_positive(np.where(known, covariance_m2, np.eye(3)))), 0.0)
    points_m, mean_m = np.where(known[..., 0], points3d_m, 0.0), np.nan_to_num(start_m)
    seen = np.asarray(known.any(axis=1))
    for _ in range(_MEAN_ITERATIONS):
        off_m = points_m - mean_m[:, None]
        squared = np.einsum("tcji,tcjik,tcjk->tcj", off_m, information, off_m)
        weighted = robust_weight(squared, config.kernel, config.kernel_scale)[..., None, None] * information
        total = surely_positive(np.where(seen, weighted.sum(axis=1), np.eye(3)))
        mean_m = np.linalg.solve(total, np.einsum("tcjik,tcjk->tji", weighted, points_m)[..., None])[..., 0]
    return np.where(seen[..., 0], mean_m, start_m)


def _from_triangulation(
    triangulated_m: Float[np.ndarray, "frame joint 3"],
    undistorted_px: Float[np.ndarray, "frame camera joint 2"],
    rig: CameraRig,
    config: FusionConfig,
) -> Fusion:
    squared_px2 = np.sum((rig.project(triangulated_m) - undistorted_px) ** 2, axis=-1)
    error = squared_px2 if config.exponent == "squared" else np.sqrt(squared_px2)
    weights = np.where(np.isfinite(error), _reciprocal(error), 0.0)
    return Fusion(triangulated_m, weights, error, np.repeat(squared_px2[:, None], rig.n_cameras, axis=1))
