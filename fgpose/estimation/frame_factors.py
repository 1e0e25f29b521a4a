"""The factors of ONE frame: what the cameras saw, symmetry, motion from the frame before, weak priors.

Pure: plain numbers in, factors out. The solvers differ only in how they string frames together.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import gtsam
import numpy as np
from jaxtyping import Bool, Float

from fgpose.config import DepthConfig, FusionConfig, Kernel, MotionConfig, PriorConfig, ProjectionConfig, SymmetryConfig
from fgpose.estimation.keys import length_key, position_key, velocity_key
from fgpose.estimation.noise import correlated_frames
from fgpose.estimation.process_noise import least_density
from fgpose.geometry.camera import CameraRig
from fgpose.skeleton import Skeleton
from fgpose_factors import (
    constant_velocity_factor,
    depth_factor,
    fading_velocity_factor,
    noise_model,
    projection_factor,
    random_walk_factor,
    symmetric_bone_length_factor,
)

# A motion model that foresees a position to better than this leaves the cameras no digits of the double precision that
# the elimination works in: GTSAM then calls the system indeterminate (seen at 4 um).
_FINEST_STEP_M = 1e-5
# Nearer than this two joints are at one point, as two detections at one pixel in every view make them.
_ONE_POINT_M = 1e-9
# Making a noise model costs as much as making a factor; sigmas that agree to a thousandth share theirs.
_SIGMAS_PER_E_FOLD = 1000

# The depth of one view can be far off.
ANCHOR_KERNEL: Kernel = "cauchy"
ANCHOR_KERNEL_SCALE = 1.5


@dataclass(frozen=True)
class FrameTime:
    """A frame's number and time."""

    frame: int
    time_s: float


def projection_factors(
    rig: CameraRig,
    frame: int,
    undistorted_px: Float[np.ndarray, "camera joint 2"],
    weights: Float[np.ndarray, "camera joint"],
    active: Bool[np.ndarray, " joint"],
    config: ProjectionConfig,
) -> Iterator[gtsam.NonlinearFactor]:
    """One reprojection factor per camera and joint that has a detection; sigma = sigma_px / sqrt(weight)."""
    used = np.isfinite(undistorted_px).all(axis=-1) & active
    sigmas_px = projection_sigma_px(weights, config)
    for camera, joint in np.argwhere(used).tolist():
        noise = _projection_noise(float(sigmas_px[camera, joint]), config.kernel, config.kernel_scale)
        yield projection_factor(
            position_key(joint, frame), undistorted_px[camera, joint], noise, rig.cameras[camera].gtsam
        )


def projection_sigma_px(
    weights: Float[np.ndarray, "*detections"], config: ProjectionConfig
) -> Float[np.ndarray, "*detections"]:
    """Standard deviation of each detection; sigmas that agree to a thousandth are the same."""
    steps = np.round(-_SIGMAS_PER_E_FOLD / 2 * np.log(np.maximum(weights, config.min_weight)))
    return config.sigma_px * np.exp(steps / _SIGMAS_PER_E_FOLD)


@lru_cache(maxsize=4096)
def _projection_noise(sigma_px: float, kernel: Kernel, kernel_scale: float) -> gtsam.noiseModel.Base:
    return noise_model(2, sigma_px, kernel, kernel_scale)


def symmetry_factors(
    skeleton: Skeleton, frame: int, active: Bool[np.ndarray, " joint"], config: SymmetryConfig
) -> Iterator[gtsam.NonlinearFactor]:
    """Left minus right length of the four limb pairs (eq. 4), where all four joints are in the graph."""
    noise = noise_model(1, config.sigma_m)
    for left, right in skeleton.limb_pairs:
        if active[[*left, *right]].all():
            keys = [position_key(joint, frame) for joint in (*left, *right)]
            yield symmetric_bone_length_factor((keys[0], keys[1]), (keys[2], keys[3]), noise)


def motion_factors(
    before: FrameTime,
    after: FrameTime,
    joints: Sequence[int],
    density: Float[np.ndarray, " joint"],
    config: MotionConfig,
) -> Iterator[gtsam.NonlinearFactor]:
    """One factor per joint that is in the graph in both frames; density: of the noise of every joint of the skeleton,
    see fgpose.estimation.process_noise."""
    if config.model == "none":
        return
    step_s = max(after.time_s - before.time_s, shortest_step_s(config))
    for joint in joints:
        start, end = position_key(joint, before.frame), position_key(joint, after.frame)
        if config.model == "random_walk":
            yield random_walk_factor(start, end, step_s, float(density[joint]))
        else:
            yield constant_velocity_factor(
                (start, velocity_key(joint, before.frame), before.time_s),
                (end, velocity_key(joint, after.frame), before.time_s + step_s),
                float(density[joint]),
            )


def shortest_step_s(config: MotionConfig) -> float:
    """The least time between two frames that the motion model is given, even when they are nearer than that.

    Over it the model foresees a position to _FINEST_STEP_M: q h = s^2, or q h^3 / 12 = s^2. That is at most 1.6 ms with
    the default densities, so that bursts of frames are no trouble.
    """
    if config.model == "random_walk":
        return _FINEST_STEP_M**2 / least_density(config)
    return (12 * _FINEST_STEP_M**2 / least_density(config)) ** (1 / 3)


def fading_factors(
    skeleton: Skeleton,
    frame: int,
    step_s: float,
    active: Bool[np.ndarray, " joint"],
    seen: Bool[np.ndarray, " joint"],
    density: Float[np.ndarray, " joint"],
    config: MotionConfig,
) -> Iterator[gtsam.NonlinearFactor]:
    """The velocity of every unseen joint fades to that of the joint it hangs on; nobody seen: to standing still."""
    if config.model != "constant_velocity":
        return
    for joint in np.flatnonzero(active & ~seen).tolist():
        held_by = holder(skeleton, joint, active, seen)
        reference = None if held_by is None else velocity_key(held_by, frame)
        yield fading_velocity_factor(
            velocity_key(joint, frame), reference, step_s, float(density[joint]), config.fade_s
        )


def holder(skeleton: Skeleton, joint: int, active: np.ndarray, seen: np.ndarray) -> int | None:
    """The neighbour that an unseen joint moves with: a seen one, or the one nearer to the root."""
    neighbours = [other for other in skeleton.neighbours[joint] if active[other]]
    seen_neighbours = [other for other in neighbours if seen[other]]
    parents = [a for a, b in skeleton.bones if b == joint and active[a]]
    return next(iter(seen_neighbours + parents), None)


def anchor_factors(
    frame: int, anchored: Bool[np.ndarray, " joint"], fused_m: Float[np.ndarray, "joint 3"], config: FusionConfig
) -> Iterator[gtsam.NonlinearFactor]:
    """Hold joints that cannot be triangulated near the fused per-view 3D.

    With fewer than two rays, motion and bones alone would let the body shrink towards the camera: every length and
    every velocity becomes cheaper on the way.
    """
    noise = noise_model(3, config.anchor_sigma_m, ANCHOR_KERNEL, ANCHOR_KERNEL_SCALE)
    for joint in np.flatnonzero(anchored).tolist():
        yield gtsam.PriorFactorPoint3(position_key(joint, frame), fused_m[joint], noise)


def depth_factors(
    frame: int,
    step_s: float,
    active: Bool[np.ndarray, " joint"],
    views_m: Float[np.ndarray, "view joint 3"],
    rays: Float[np.ndarray, "view joint 3"],
    sigma_m: Float[np.ndarray, "view joint"],
    config: DepthConfig,
) -> Iterator[gtsam.NonlinearFactor]:
    """One factor per view and joint whose depth is used; sigma_m NaN where it is not."""
    spread = float(depth_spread(np.array([step_s]), config)[0])
    for view, joint in np.argwhere(np.isfinite(sigma_m) & active).tolist():
        yield depth_factor(
            position_key(joint, frame),
            views_m[view, joint],
            rays[view, joint],
            spread * float(sigma_m[view, joint]),
            config.kernel,
            config.kernel_scale,
        )


def depth_spread(step_s: Float[np.ndarray, " frame"], config: DepthConfig) -> Float[np.ndarray, " frame"]:
    """Factor on the standard deviation of a depth whose error stays alike: so many frames count as one measurement.

    Args:
        step_s: time since the frame before; inf for the first frame.
        config: has the time over which errors stay alike.
    """
    return np.sqrt(correlated_frames(step_s, config.correlation_s))


def prior_factors(
    frame: int,
    joints: Sequence[int],
    positions_m: Float[np.ndarray, "joint 3"],
    config: PriorConfig,
    *,
    with_velocity: bool,
) -> Iterator[gtsam.NonlinearFactor]:
    """Weak priors where a joint enters the graph: around its first guess, and around standing still."""
    position_noise = noise_model(3, config.position_sigma_m)
    velocity_noise = noise_model(3, config.velocity_sigma_mps)
    for joint in joints:
        yield gtsam.PriorFactorPoint3(position_key(joint, frame), positions_m[joint], position_noise)
        if with_velocity:
            yield gtsam.PriorFactorPoint3(velocity_key(joint, frame), np.zeros(3), velocity_noise)


def length_prior_factors(lengths_m: Float[np.ndarray, " length"], sigma_m: float) -> Iterator[gtsam.NonlinearFactor]:
    """Prior on every shared length that has a value (not NaN)."""
    noise = noise_model(1, sigma_m)
    for length in np.flatnonzero(np.isfinite(lengths_m)).tolist():
        yield gtsam.PriorFactorDouble(length_key(length), float(lengths_m[length]), noise)


def known_length_factors(
    skeleton: Skeleton,
    frame: int,
    active: Bool[np.ndarray, " joint"],
    positions_m: Float[np.ndarray, "joint 3"],
    lengths_m: Float[np.ndarray, " length"],
    sigmas_m: Float[np.ndarray, " length"],
) -> Iterator[gtsam.NonlinearFactor]:
    """Native range factors: every bone has the length that was learned for it and its mirror image.

    None where its joints start at one point: a distance of zero has no direction, and GTSAM's Jacobian of it is NaN.

    Args:
        positions_m: first guess of every active joint.
    """
    apart = skeleton.bone_lengths(positions_m) > _ONE_POINT_M
    for (start, end), length, is_apart in zip(skeleton.bones, skeleton.length_of_bone, apart, strict=True):
        if is_apart and active[start] and active[end] and np.isfinite(lengths_m[length]):
            keys = position_key(start, frame), position_key(end, frame)
            yield gtsam.RangeFactor3(*keys, float(lengths_m[length]), noise_model(1, float(sigmas_m[length])))
