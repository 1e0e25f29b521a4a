"""From observations to evidence: everything is computed once, for every solver."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float

from fgpose.config import Config, DepthConfig, FusionConfig
from fgpose.estimation.evidence.credibility import credible
from fgpose.estimation.evidence.delays import by_mean_clock, delays_s
from fgpose.estimation.evidence.evidence import FARTHEST_M, Evidence, is_same_in_all_frames
from fgpose.estimation.evidence.fusion import fuse_undistorted
from fgpose.estimation.evidence.plausibility import (
    Bodies,
    beyond_reach,
    far_outside_images,
    middles_m,
    off_body,
    without_clipped,
)
from fgpose.estimation.evidence.weights import detection_weights
from fgpose.frozen import changed
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.changing_rig import refuse_changing
from fgpose.geometry.per_view.view_depth import RELATIVE_SIGMA, ViewDepth
from fgpose.geometry.triangulation import USUAL_FROM_M, triangulate_robust
from fgpose.observations import Observations, blanked
from fgpose.sampling import parts_of
from fgpose.skeleton import Skeleton
from fgpose_factors.robust_statistics import robust_sigma

FRAMES_AT_ONCE = 1000
"""Bounds the memory of intermediate arrays."""
_FEW_VIEWS = 2  # three rays determine a joint even if one is wrong; see depth.use
# So many depths of a view tell their spread: 17 joints for 30 frames. The depths of a body share most of their error,
# which is correlated in time, so fewer would tell the error of that moment.
_ENOUGH_DEPTHS = 500
# Depths that were triangulated themselves fit better than any network's.
_LEAST_RELATIVE_SIGMA = 0.01


def gather(observations: Observations, rig: CameraRig, config: Config) -> Evidence:
    """The evidence of all frames; the detections of frames that make no body are left out (Evidence.implausible).

    Args:
        observations: of one person.
        rig: cameras of the observations, in their order. What all are late by counts as the time of the frames.
        config: the parameters.

    Raises:
        ValueError: the cameras of observations and rig differ, or the calibration is in millimetres.
    """
    observations.check_cameras(rig.names)
    refuse_changing(rig)
    observations, rig = by_mean_clock(observations, rig)
    said = credible(observations.confidence, observations.frame_time_s)
    evidence = _gather(observations, rig, config, said)
    bodies = _bodies(evidence, observations.skeleton)
    bodies.refuse_millimetres()
    if not bodies.implausible.any() or bodies.are_mostly_implausible:
        return evidence
    return without(evidence, observations, bodies.implausible, rig, config)


def gather_frame(
    frame: Observations,
    rig: CameraRig,
    config: Config,
    credible: Float[np.ndarray, "1 joint"],
    *,
    may_leave_out: bool = True,
) -> tuple[Evidence, Bodies]:
    """As gather, of one frame of a stream, which alone tells neither whether the calibration is wrong nor what is
    credible."""
    evidence = _gather(frame, rig, config, credible)
    bodies = _bodies(evidence, frame.skeleton)
    if may_leave_out and bodies.implausible.any():
        evidence = without(evidence, frame, bodies.implausible, rig, config)
    return evidence, bodies


def _bodies(evidence: Evidence, skeleton: Skeleton) -> Bodies:
    return Bodies.of(evidence.guess_m, evidence.n_views, evidence.implausible, skeleton)


def without(
    evidence: Evidence,
    observations: Observations,
    frames: Bool[np.ndarray, " frame"],
    rig: CameraRig,
    config: Config,
) -> Evidence:
    """The evidence of these observations with nothing detected in some frames."""

    def emptied(array: np.ndarray) -> np.ndarray:
        return np.full_like(array[frames], np.nan)

    some = observations.frames(frames)
    said = np.ones((some.n_frames, some.skeleton.n_joints))
    nothing = _gather(replace(some, **observations.per_detection(emptied)), rig, config, said)
    nothing = changed(nothing, implausible=np.ones_like(nothing.implausible))
    if frames.all():
        return nothing
    values = {}
    for name, array in evidence.arrays.items():
        values[name] = array
        if not is_same_in_all_frames(array):
            values[name] = array.copy()
            values[name][frames] = getattr(nothing, name)
    return Evidence(**values)


def _gather(
    observations: Observations, rig: CameraRig, config: Config, credible: Float[np.ndarray, "frame joint"]
) -> Evidence:
    evidence, triangulated_m = _in_parts(observations, rig, config, credible)
    if config.depth.use == "never" or observations.points3d_m is None:
        return evidence
    # Of all frames together: the whole recording tells how good the depths are.
    rays, depth_sigma_m = _depths(observations, observations.points3d_m, rig, triangulated_m, config.depth)
    return changed(
        evidence,
        views_m=observations.points3d_m,
        rays=rays,
        depth_sigma_m=depth_sigma_m,
        anchored=evidence.anchored & ~np.isfinite(depth_sigma_m).any(axis=1),
    )


def _in_parts(
    observations: Observations, rig: CameraRig, config: Config, credible: Float[np.ndarray, "frame joint"]
) -> tuple[Evidence, Float[np.ndarray, "frame joint 3"]]:
    """without_depths, of a long recording part by part."""
    if observations.n_frames <= FRAMES_AT_ONCE:
        return without_depths(observations, rig, config, credible)
    whole: dict[str, np.ndarray] = {}
    for part in parts_of(observations.n_frames, FRAMES_AT_ONCE):
        evidence, triangulated_m = without_depths(observations.frames(part), rig, config, credible[part])
        for name, values in (evidence.arrays | {"triangulated_m": triangulated_m}).items():
            if name not in whole:
                whole[name] = _of_all_frames(values, observations.n_frames)
            if whole[name].flags.writeable:
                whole[name][part] = values
    triangulated_m = whole.pop("triangulated_m")
    return Evidence(**whole), triangulated_m


def _of_all_frames(of_some: np.ndarray, n_frames: int) -> np.ndarray:
    """An array like this of all frames, to be filled; as it is, where it is the same in all frames."""
    shape = n_frames, *of_some.shape[1:]
    return np.broadcast_to(of_some[0], shape) if is_same_in_all_frames(of_some) else np.empty(shape, of_some.dtype)


def without_depths(
    observations: Observations, rig: CameraRig, config: Config, credible: Float[np.ndarray, "frame joint"]
) -> tuple[Evidence, Float[np.ndarray, "frame joint 3"]]:
    """The evidence but for the depths of the views, and the triangulated joints; frame by frame."""
    observations = without_clipped(observations, rig)
    far_outside = far_outside_images(observations.points2d_px, rig)
    undistorted_px, confidence = rig.undistort(observations.points2d_px), observations.confidence.astype(float)
    triangulated_m, middle_m, beyond = _triangulated(
        blanked(undistorted_px, far_outside), confidence, observations.skeleton, rig, config.fusion
    )
    observations, confidence = observations.without(beyond), np.where(beyond, 0.0, confidence)
    of_body, views_m = observations, observations.points3d_m
    if views_m is not None:
        of_body = observations.without(off_body(views_m, middle_m))
    fusion = fuse_undistorted(of_body, triangulated_m, blanked(undistorted_px, beyond), rig, config)
    guessed = np.asarray(np.isnan(triangulated_m).any(axis=-1))
    no_view = np.zeros((observations.n_frames, 0, observations.skeleton.n_joints))
    nowhere = no_view[..., None].repeat(3, axis=-1)
    evidence = Evidence(
        time_s=observations.frame_time_s,
        undistorted_px=undistorted_px,
        confidence=confidence,
        weights=detection_weights(fusion, confidence, rig, config.projection),
        sigma_px=np.broadcast_to(rig.in_own_px(config.projection.sigma_px), confidence.shape),
        credible=credible,
        n_views=observations.seen.sum(axis=1),
        fused_m=fusion.positions_m,
        guess_m=np.where(guessed[..., None], fusion.positions_m, triangulated_m),
        anchored=guessed & np.isfinite(fusion.positions_m).all(axis=-1),
        views_m=nowhere,
        rays=nowhere,
        depth_sigma_m=no_view,
        delay_s=delays_s(observations, rig),
        implausible=2 * far_outside.sum(axis=(1, 2)) > observations.seen.sum(axis=(1, 2)),
        **_not_known_yet(confidence.shape),
    )
    return evidence, triangulated_m


def _triangulated(
    undistorted_px: Float[np.ndarray, "frame camera joint 2"],
    confidence: Float[np.ndarray, "frame camera joint"],
    skeleton: Skeleton,
    rig: CameraRig,
    config: FusionConfig,
) -> tuple[Float[np.ndarray, "frame joint 3"], Float[np.ndarray, "frame 3"], Bool[np.ndarray, "frame camera joint"]]:
    """The joints, NaN where no two cameras agree on the body; the middle of the body; and the detections that are too
    far from it."""

    def found_m(px: np.ndarray, confidence: np.ndarray) -> Float[np.ndarray, "frame joint 3"]:
        inlier_px = rig.in_own_px(config.inlier_px)
        positions_m = triangulate_robust(px, confidence, rig, inlier_px, usual_from_m=USUAL_FROM_M).positions_m
        positions_m[(np.abs(positions_m) > FARTHEST_M).any(axis=-1)] = np.nan
        return positions_m

    triangulated_m = found_m(undistorted_px, confidence)
    middle_m = middles_m(triangulated_m[:, list(skeleton.body)])
    beyond = beyond_reach(undistorted_px, middle_m, rig)
    frames, joints = np.nonzero(beyond.any(axis=1))
    if len(frames):
        of_body_px = blanked(undistorted_px, beyond)[frames, :, joints, None]
        triangulated_m[frames, joints] = found_m(of_body_px, confidence[frames, :, joints, None])[:, 0]
    triangulated_m[off_body(triangulated_m, middle_m)] = np.nan
    return triangulated_m, middle_m, beyond


@lru_cache(maxsize=16)  # asked for at every update of the online estimator
def _not_known_yet(shape: tuple[int, int, int]) -> Mapping[str, np.ndarray]:
    """What only a motion tells of so many frames, cameras and joints; one number each takes no memory."""
    n_frames, _, n_joints = shape
    return {
        "bias_px": np.broadcast_to(0.0, (*shape, 2)),
        "bias_share": np.broadcast_to(1.0, (n_frames, n_joints)),
        "bias_m2": np.broadcast_to(0.0, (n_frames, n_joints, 3, 3)),
        "visibility": np.broadcast_to(1.0, shape),
        "off_path_m": np.broadcast_to(np.nan, (n_frames, n_joints, 3)),
        "from_bones": np.broadcast_to(np.False_, (n_frames, n_joints)),
        "sides_exchanged": np.broadcast_to(np.False_, shape),
        "held_m": np.broadcast_to(np.nan, (n_frames, n_joints, 3)),
        "held_information": np.broadcast_to(0.0, (n_frames, n_joints, 3, 3)),
    }


def _depths(
    observations: Observations,
    views_m: Float[np.ndarray, "frame camera joint 3"],
    rig: CameraRig,
    triangulated_m: Float[np.ndarray, "frame joint 3"],
    config: DepthConfig,
) -> tuple[Float[np.ndarray, "frame camera joint 3"], Float[np.ndarray, "frame camera joint"]]:
    """Evidence.rays and depth_sigma_m of these observations with per-view 3D."""
    position_m = rig.positions_m[:, None]
    depth = ViewDepth.of(views_m, observations.covariance3d_m2, position_m)
    rays, distance_m, sigma_m = depth.rays, depth.distance_m, depth.sigma_m
    unstated = np.isnan(sigma_m) & np.isfinite(distance_m)
    if unstated.any():
        error_m = np.einsum("tcji,tcji->tcj", rays, views_m - triangulated_m[:, None])
        sigma_m = np.where(unstated, distance_m * _relative_sigma(error_m / distance_m)[:, None], sigma_m)
    if config.use == "few_views":
        few = observations.seen.sum(axis=1, keepdims=True) <= _FEW_VIEWS
        sigma_m = np.where(few, sigma_m, np.nan)
    return rays, sigma_m


def _relative_sigma(error: Float[np.ndarray, "frame camera joint"]) -> Float[np.ndarray, " camera"]:
    """Standard deviation of the depths of each view that does not state any, relative to the distance.

    From the recording, as far as it is long enough to tell; robust, for triangulated joints may be hallucinated.

    Args:
        error: of the depths against the triangulated joints, relative to the distance; NaN where either is missing.
    """
    sigma = np.full(error.shape[1], RELATIVE_SIGMA)
    for view in range(error.shape[1]):
        known = error[:, view][np.isfinite(error[:, view])]
        if known.size >= _ENOUGH_DEPTHS:
            sigma[view] = max(robust_sigma(known), _LEAST_RELATIVE_SIGMA)
    return sigma
