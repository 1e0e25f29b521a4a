"""Scenes: a true motion as the cameras of a rig would have seen it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from fgpose.skeleton import Skeleton
from fgpose_benchmarks.synthetic.noise import MIN_CONFIDENCE, DetectionNoise, bias_m, detection_error, stated_confidence
from fgpose_benchmarks.synthetic.occlusion import Occlusion, hallucination, occluded_joints
from fgpose_benchmarks.synthetic.real_errors import RealErrors
from fgpose_benchmarks.synthetic.snapping import shown_joints

_MIN_LATERAL_M = 1e-3  # a covariance must be positive definite


@dataclass(frozen=True, eq=False)
class Scene:
    """A person whose motion is known exactly, and what the cameras saw of it."""

    truth_m: Float[np.ndarray, "frame joint 3"]
    """World frame, metres."""
    observations: Observations
    occluded: Bool[np.ndarray, "frame camera joint"]
    """Whether an occluder hides the joint from the camera; it may be detected (hallucinated) all the same. Of real
    errors: see RealErrors.hidden."""
    rig: CameraRig


def simulate(
    truth_m: Float[np.ndarray, "frame joint 3"],
    skeleton: Skeleton,
    rig: CameraRig,
    fps: float,
    noise: DetectionNoise,
    occlusion: Occlusion,
    seed: int,
    offsets_s: Float[np.ndarray, " camera"] | None = None,
    real: RealErrors | None = None,
) -> Scene:
    """What the cameras of the rig would have seen of this motion (world frame, metres).

    Joints outside the image are missing. The same seed gives the same scene, and the noise of a detection does not
    depend on what is occluded: scenes with and without occlusion differ in the occluded joints alone.

    Args:
        offsets_s: how much later than its observations say each camera took its images.
        real: what real detectors did, instead of the noise in the image and its confidence.

    Raises:
        ValueError: more views are occluded than there are cameras, or the truth is empty, not finite or of another
            number of joints.
    """
    if occlusion.n_views > rig.n_cameras:
        raise ValueError(f"{occlusion.n_views} occluded views need as many cameras, the rig has {rig.n_cameras}")
    if truth_m.shape[1] != skeleton.n_joints or len(truth_m) == 0 or not np.isfinite(truth_m).all():
        raise ValueError(f"the truth must be (frames, {skeleton.n_joints}, 3) and finite, got {truth_m.shape}")
    # Whatever draws more gets a stream of its own, behind the others: scenes of old seeds stay the same.
    noise_rng, hidden_rng, occluder_rng, snap_rng, bias_rng = np.random.default_rng(seed).spawn(5)
    seen_m = _at_camera_times(truth_m, fps, np.zeros(rig.n_cameras) if offsets_s is None else offsets_s)
    true_px = rig.project_each(seen_m)
    occluded = occluded_joints(occluder_rng, true_px, fps, occlusion)
    shown = shown_joints(snap_rng, occluded, true_px, skeleton, occlusion.snap_share)[..., None]
    snapped = shown[..., 0] != np.arange(skeleton.n_joints)
    seen_m, true_px = (np.take_along_axis(array, shown, axis=2) for array in (seen_m, true_px))
    error = detection_error(noise_rng, occluded.shape, skeleton, fps, noise)
    hidden = hallucination(hidden_rng, occluded.shape, fps, occlusion)
    hallucinated = occluded & ~snapped
    visible_px = error.pixel_px if real is None else _lateral_px(rig, seen_m, real.error_m)
    if noise.max_bias_m > 0:
        visible_px = visible_px + _lateral_px(rig, seen_m, bias_m(bias_rng, occluded.shape[1:], noise))
    pixel_px = visible_px + np.where(hallucinated[..., None], hidden.pixel_px, 0.0)
    depth_m = error.depth_m + np.where(hallucinated, hidden.depth_m, 0.0)
    level = np.where(hallucinated, occlusion.confidence, np.where(snapped, occlusion.snap_confidence, noise.confidence))
    stated = stated_confidence(level, pixel_px, error.confidence, skeleton, noise)
    confidence = stated if real is None else np.maximum(real.confidence, MIN_CONFIDENCE)
    detected = _in_image(rig, true_px) & ~(hallucinated & hidden.missing) & np.isfinite(pixel_px).all(axis=-1)
    observations = Observations(
        skeleton=skeleton,
        time_s=np.arange(len(truth_m)) / fps,
        points2d_px=_original_px(rig, np.where(detected[..., None], true_px + pixel_px, np.nan)),
        confidence=np.where(detected, confidence, 0.0),
        points3d_m=np.where(
            detected[..., None], _views_3d(rig, seen_m, true_px + pixel_px, depth_m, error.lateral_m), np.nan
        ),
        camera_names=rig.names,
        covariance3d_m2=_stated_covariance_m2(rig, seen_m, noise.depth_sigma_m(skeleton), noise),
    )
    return Scene(truth_m, observations, occluded if real is None else occluded | real.hidden, rig)


def _lateral_px(
    rig: CameraRig,
    seen_m: Float[np.ndarray, "frame camera joint 3"],
    lateral_m: Float[np.ndarray, "*frame camera joint 2"],
) -> Float[np.ndarray, "frame camera joint 2"]:
    """Errors along the axes of the image, in metres at the joint's depth, as pixels."""
    depth_m = np.stack([camera.to_camera_frame(seen_m[:, c])[..., 2] for c, camera in enumerate(rig.cameras)], axis=1)
    focal_px = np.array([np.diag(camera.K)[:2] for camera in rig.cameras])
    return lateral_m * focal_px[:, None] / depth_m[..., None]


def _at_camera_times(
    truth_m: Float[np.ndarray, "frame joint 3"], fps: float, offsets_s: Float[np.ndarray, " camera"]
) -> Float[np.ndarray, "frame camera joint 3"]:
    """The motion as every camera sees it; the spline goes on beyond its ends."""
    if not offsets_s.any():
        return np.repeat(truth_m[:, None], len(offsets_s), axis=1)
    from scipy.interpolate import CubicSpline

    time_s = np.arange(len(truth_m)) / fps
    return np.asarray(CubicSpline(time_s, truth_m)(time_s[:, None] + offsets_s))


def _original_px(
    rig: CameraRig, undistorted_px: Float[np.ndarray, "frame camera joint 2"]
) -> Float[np.ndarray, "frame camera joint 2"]:
    return np.stack([camera.distort(undistorted_px[:, c]) for c, camera in enumerate(rig.cameras)], axis=1)


def _in_image(
    rig: CameraRig, true_px: Float[np.ndarray, "frame camera joint 2"]
) -> Bool[np.ndarray, "frame camera joint"]:
    size_px = np.array([camera.size_px for camera in rig.cameras])[:, None]
    original_px = _original_px(rig, true_px)
    return np.all((original_px >= 0) & (original_px < size_px), axis=-1)


def _views_3d(
    rig: CameraRig,
    seen_m: Float[np.ndarray, "frame camera joint 3"],
    undistorted_px: Float[np.ndarray, "frame camera joint 2"],
    depth_error_m: Float[np.ndarray, "frame camera joint"],
    lateral_error_m: Float[np.ndarray, "frame camera joint 2"],
) -> Float[np.ndarray, "frame camera joint 3"]:
    """Each view's 3D joints in the world frame: on the ray of the detected point, at a wrong depth."""
    views_m = []
    for c, camera in enumerate(rig.cameras):
        true_depth_m = camera.to_camera_frame(seen_m[:, c])[..., 2]
        # No estimator puts a person closer than a fifth of the distance.
        depth_m = np.maximum(true_depth_m + depth_error_m[:, c], 0.2 * true_depth_m)[..., None]
        slope = (undistorted_px[:, c] - camera.K[:2, 2]) / np.diag(camera.K)[:2]
        views_m.append(
            camera.to_world_frame(np.concatenate([slope * depth_m + lateral_error_m[:, c], depth_m], axis=-1))
        )
    return np.stack(views_m, axis=1)


def _stated_covariance_m2(
    rig: CameraRig,
    seen_m: Float[np.ndarray, "frame camera joint 3"],
    depth_sigma_m: Float[np.ndarray, " joint"],
    noise: DetectionNoise,
) -> Float[np.ndarray, "frame camera joint 3 3"] | None:
    """What an estimator states that knows its noise but not what hides a joint; None without noise."""
    if not depth_sigma_m.all():
        return None
    covariances_m2 = []
    for c, camera in enumerate(rig.cameras):
        ray_m = seen_m[:, c] - camera.position_m
        distance_m = np.linalg.norm(ray_m, axis=-1)[..., None, None]
        along = ray_m[..., :, None] * ray_m[..., None, :] / distance_m**2
        sigma_px = np.hypot(noise.sigma_px, noise.correlated_px)
        across_m2 = (sigma_px * distance_m / camera.K[0, 0]) ** 2 + noise.lateral_m**2 + _MIN_LATERAL_M**2
        covariances_m2.append(depth_sigma_m[:, None, None] ** 2 * along + across_m2 * (np.eye(3) - along))
    return np.stack(covariances_m2, axis=1)
