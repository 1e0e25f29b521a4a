"""Errors of a monocular estimator on a person that it sees, in physical units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.skeleton import Skeleton

# Measured SD of a joint's depth around that of the whole body. Trunk and head were not measured: between hip and knee.
_JOINT_DEPTH_M = {"hip": 0.055, "knee": 0.082, "ankle": 0.081, "shoulder": 0.080, "elbow": 0.122, "wrist": 0.150}
_TRUNK_DEPTH_M = 0.065
MIN_CONFIDENCE = 0.02  # 0 would mean that there is no detection


def check_scales(settings: object, *, shares: tuple[str, ...]) -> None:
    """Raise ValueError unless every number is finite and not negative, and the named shares do not exceed 1."""
    for name, value in vars(settings).items():
        if isinstance(value, str):
            continue
        upper = 1.0 if name in shares else np.inf
        if not np.isfinite(value) or not 0 <= value <= upper:
            raise ValueError(f"{type(settings).__name__}.{name} must be in [0, {upper:g}], got {value!r}")


@dataclass(frozen=True)
class DetectionNoise:
    """Errors of a monocular estimator on a person that it sees. A 3D joint lies on the ray of its erroneous 2D point.

    Raises:
        ValueError: a number is negative or not finite, or a share lies outside [0, 1].
    """

    sigma_px: float = 3.0
    """SD of each pixel coordinate, independent from frame to frame."""
    correlated_px: float = 4.0
    """SD of each pixel coordinate, correlated in time."""
    outlier_share: float = 0.01
    """Share of the detections that are off by outlier_px, one frame at a time."""
    outlier_px: float = 40.0
    """SD of each coordinate of an outlier, pixels."""
    camera_bias_m: float = 0.08
    """SD of the constant depth error of each camera, metres."""
    body_depth_m: float = 0.10
    """SD of the depth error that all joints of a view share, correlated in time, metres."""
    joint_depth_scale: float = 1.0
    """Depth error of each joint, correlated in time, relative to the measured one (55 mm hips to 150 mm wrists)."""
    lateral_m: float = 0.01
    """SD of each lateral coordinate of a 3D joint around the ray of its 2D point. With the defaults the whole lateral
    error at 4.5 m and 1145 px is about 20 mm, as measured."""
    correlation_s: float = 0.15
    """Time constant of what is correlated in time, seconds: autocorrelation exp(-t / constant)."""
    confidence: float = 0.8
    """Mean confidence of an exact, visible detection."""
    confidence_spread: float = 0.2
    """SD of the confidence around its mean, correlated in time. Raising it makes confidence tell less."""
    confidence_fall_px: float = 200.0
    """Pixel error over which the mean confidence falls to 1/e. Raising it makes confidence tell less; 0: no fall."""
    min_bias_m: float = 0.0
    """Length of the constant error in the image of each joint in each view, metres at the joint's depth, in a random
    direction: uniform from min_bias_m ..."""
    max_bias_m: float = 0.0
    """... to max_bias_m."""
    misled_joint: str = ""
    """Joint whose confidence tells the wrong thing: one minus what it would be. Empty: none."""

    def __post_init__(self) -> None:
        check_scales(self, shares=("outlier_share", "confidence"))
        if self.min_bias_m > self.max_bias_m:
            raise ValueError("DetectionNoise.min_bias_m must not exceed max_bias_m")

    def depth_sigma_m(self, skeleton: Skeleton) -> Float[np.ndarray, " joint"]:
        """SD of each joint's depth in one view, as an honest estimator states it; what hides the joint not counted."""
        of_joint_m = self.joint_depth_scale * joint_depth_m(skeleton)
        return np.sqrt(self.camera_bias_m**2 + self.body_depth_m**2 + of_joint_m**2)


NO_NOISE = DetectionNoise(
    sigma_px=0.0,
    correlated_px=0.0,
    outlier_share=0.0,
    camera_bias_m=0.0,
    body_depth_m=0.0,
    joint_depth_scale=0.0,
    lateral_m=0.0,
    confidence=1.0,
    confidence_spread=0.0,
    confidence_fall_px=0.0,
)
"""Perfect detections."""


@dataclass(frozen=True)
class DetectionError:
    pixel_px: Float[np.ndarray, "frame camera joint 2"]
    depth_m: Float[np.ndarray, "frame camera joint"]
    lateral_m: Float[np.ndarray, "frame camera joint 2"]
    confidence: Float[np.ndarray, "frame camera joint"]
    """Standard normal."""


def detection_error(
    rng: np.random.Generator, shape: tuple[int, ...], skeleton: Skeleton, fps: float, noise: DetectionNoise
) -> DetectionError:
    """Every draw is made for every joint, seen or not, so that the stream does not depend on visibility."""

    def correlated(shape: tuple[int, ...]) -> np.ndarray:
        return correlated_normal(rng, shape, fps, noise.correlation_s)

    frames, cameras, _ = shape
    pixel_px = noise.sigma_px * rng.standard_normal((*shape, 2)) + noise.correlated_px * correlated((*shape, 2))
    outlier = rng.random(shape) < noise.outlier_share
    pixel_px += np.where(outlier[..., None], noise.outlier_px * rng.standard_normal((*shape, 2)), 0.0)
    depth_m = noise.camera_bias_m * rng.standard_normal((1, cameras, 1))
    depth_m = depth_m + noise.body_depth_m * correlated((frames, cameras, 1))
    depth_m = depth_m + noise.joint_depth_scale * joint_depth_m(skeleton) * correlated(shape)
    return DetectionError(pixel_px, depth_m, noise.lateral_m * correlated((*shape, 2)), correlated(shape))


def bias_m(
    rng: np.random.Generator, shape: tuple[int, int], noise: DetectionNoise
) -> Float[np.ndarray, "camera joint 2"]:
    """Constant error of each joint in each view, metres along the axes of the image."""
    angle = rng.uniform(0.0, 2 * np.pi, shape)
    length_m = rng.uniform(noise.min_bias_m, noise.max_bias_m, shape)
    return length_m[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def stated_confidence(
    level: Float[np.ndarray, "frame camera joint"],
    pixel_px: Float[np.ndarray, "frame camera joint 2"],
    spread: Float[np.ndarray, "frame camera joint"],
    skeleton: Skeleton,
    noise: DetectionNoise,
) -> Float[np.ndarray, "frame camera joint"]:
    """Around the mean of an exact detection, less where it is wrong; the other way round for the misled joint."""
    if noise.confidence_fall_px > 0:
        level = level * np.exp(-np.linalg.norm(pixel_px, axis=-1) / noise.confidence_fall_px)
    confidence = level + noise.confidence_spread * spread
    if noise.misled_joint:
        misled = skeleton.index(noise.misled_joint)
        confidence[..., misled] = 1.0 - confidence[..., misled]
    return np.clip(confidence, MIN_CONFIDENCE, 1.0)


def joint_depth_m(skeleton: Skeleton) -> Float[np.ndarray, " joint"]:
    """Measured SD of the depth of each joint around that of the whole body, metres."""

    def of(joint: str) -> float:
        return next((depth_m for part, depth_m in _JOINT_DEPTH_M.items() if part in joint), _TRUNK_DEPTH_M)

    return np.array([of(joint) for joint in skeleton.joints])


def correlated_normal(rng: np.random.Generator, shape: tuple[int, ...], fps: float, constant_s: float) -> np.ndarray:
    """Standard normal numbers whose autocorrelation along the first axis (frames) is exp(-t / constant_s)."""
    from scipy.signal import lfilter

    keep = np.exp(-1.0 / (fps * constant_s)) if constant_s > 0 else 0.0
    white = rng.standard_normal(shape)
    # The first frame is drawn from the stationary distribution.
    white[1:] *= np.sqrt(1.0 - keep**2)
    return np.asarray(lfilter([1.0], [1.0, -keep], white, axis=0))
