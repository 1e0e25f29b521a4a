"""From the pose that a network gives relative to the root to absolute joints in front of one camera.

The joints X are metric but relative to the root, whose position is unknown. We look for the translation t with which
the joints project onto their landmarks: (X + t)_xy = u (X + t)_z, with u the undistorted landmarks at depth one. Each
joint keeps the depth that follows from t. Across the ray it is placed on its landmark, which is several times more
accurate there than the network's X. So the 3D joints add only depth to the 2D detections, and the covariance states
that this depth is known much less well.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Bool, Float

from fgpose.geometry.camera import Camera
from fgpose.skeleton import Skeleton
from fgpose_factors.robust_statistics import CAUCHY_SCALE, MEDIAN_LENGTH

# Depth of a joint relative to the body, SD in metres, measured with BlazePose (heavy) on 400 views of one man, the
# balance recordings. Only these joints are used to find the translation. The eleven landmarks of a face share one error
# and would count eleven times; hands are the least accurate.
_DEPTH_SIGMA_M = {
    "hip": 0.055,
    "pelvis": 0.055,
    "shoulder": 0.080,
    "neck": 0.080,
    "knee": 0.082,
    "ankle": 0.081,
    "elbow": 0.122,
    "wrist": 0.150,
}
_OTHER_DEPTH_SIGMA_M = 0.12  # of joints not measured: as an elbow
# The network does not know how tall the person is. Adults differ by 4 to 5 % (SD) in height, so the relative error of
# one person's depth is constant. Measured: 4.3 % of the distance.
_SCALE_SIGMA = 0.045
# Residuals of X across the ray, over the depth sigmas (medians of 400 views: 0.32 and 0.29).
_FIT_RATIO = 0.33
_FIT_PRIOR_JOINTS = 4.0
"""Weight of the expected fit, in joints: a few joints alone always fit well."""
# Across the ray, the error of a landmark has two parts. One is a share of the body, as the network sees every body in a
# crop of the same size; the other, for people far away, is assumed to be constant in pixels. The variance is inversely
# proportional to the confidence (measured at 3.5 m: 17 mm at confidence 1, 26 at 0.4, 50 at 0.2).
_LATERAL_SIGMA_M = 0.020
_PIXEL_SIGMA_PX = 1.5

# Fewer joints, or such that the network hardly believes in, give a translation that looks certain and is wrong. Higher,
# people who are half hidden get no 3D.
_MIN_JOINTS = 6
_MIN_CONFIDENCE = 0.1
_BORDER_SHARE = 0.01
"""Share of the longer side of the image. Networks put a joint that is out of sight at the edge as often as beyond
it."""
# From this share of the joints on, the border has cut the crop too, and the pose is reported as uncertain.
_MAX_CUT_SHARE = 0.25
_MAX_DISTANCE_SIGMA = 0.2
"""Largest relative standard deviation of the distance: beyond it the pose counts as unknown."""
_MAX_FIT_RATIO = 4 * _FIT_RATIO
"""Beyond it the pose is reported as a poor fit. Lower, unusual poses are reported too."""
_MIN_DEPTH_M = 0.1
"""No network sees a person who is nearer."""
UNSTATED_CONFIDENCE = 0.5
"""Of every joint inside the image where a network states none."""
# MeTRAbs's own check calls a joint inconsistent from a spread of 200 mm on; the confidence is then 0.2.
_HALF_CONFIDENCE_M = 0.1
# Half a millimetre is far below the standard deviation of any translation.
_ITERATIONS = 10
_CONVERGED_M = 5e-4
_MIN_FIT_RATIO = 1e-3
"""Keeps the weights finite where everything fits exactly: 0.1 mm."""
_MIN_SPREAD = 1e-9  # keeps the division finite where all joints are at one pixel


@dataclass(frozen=True, eq=False)
class AbsolutePose:
    """The joints of one person as one camera alone gives them."""

    points3d_m: Float[np.ndarray, "joint 3"]
    """Camera frame; NaN where it cannot be computed."""
    covariance_m2: Float[np.ndarray, "joint 3 3"]
    """Camera frame; large along the ray, small across it; NaN where points3d_m is. The depth errors of the joints of
    one view are strongly correlated, with each other and from frame to frame."""
    problem: str
    """Empty when all is well; else why the pose is NaN or uncertain: "few joints", "cut by the border", "behind the
    camera", "ill-conditioned" or "poor fit", then a colon and the figures."""

    @staticmethod
    def missing(n_joints: int, problem: str) -> AbsolutePose:
        """All NaN."""
        return AbsolutePose(np.full((n_joints, 3), np.nan), np.full((n_joints, 3, 3), np.nan), problem)


@dataclass(frozen=True, eq=False)
class _Translation:
    t_m: Float[np.ndarray, " 3"]
    fit_ratio: float
    """Robust size of the residuals, as a multiple of the joints' depth sigmas."""
    distance_sigma_m: float
    """Of t_z, from the residuals and the spread of the joints in the image."""


def absolute_pose(
    relative_m: Float[np.ndarray, "joint 3"],
    points2d_px: Float[np.ndarray, "joint 2"],
    confidence: Float[np.ndarray, " joint"],
    camera: Camera,
    skeleton: Skeleton | None = None,
    *,
    depth_sigma_m: Float[np.ndarray, " joint"] | None = None,
    landmarks_are_projections: bool = False,
) -> AbsolutePose:
    """Absolute joints and their covariance in the camera frame from root-relative ones and their landmarks.

    Args:
        relative_m: metric joints about a root anywhere, axes of the camera (x right, y down, z forward).
        points2d_px: pixels of the original, distorted image; NaN = missing.
        confidence: in [0, 1]; 0 = missing.
        camera: the camera of the image.
        skeleton: tells which joints find the translation (hips, shoulders, limbs) and how well the depth of each is
            known. Without it all have the same weight.
        depth_sigma_m: SD of the depth of each joint relative to the body, where the network itself states it.
        landmarks_are_projections: whether they are the network's own projection of the same joints. Their agreement
            then says nothing of how good either is, and the fit counts as the usual one.

    Returns:
        AbsolutePose; a missing joint is NaN, all are NaN if no translation can be found, and problem then says why.
    """
    n_joints = len(relative_m)
    u = (camera.undistort(points2d_px) - camera.K[:2, 2]) / np.diag(camera.K)[:2]
    sigma_m, solves = _depth_sigmas(skeleton, n_joints)
    sigma_m = sigma_m if depth_sigma_m is None else depth_sigma_m
    known = np.isfinite(relative_m).all(axis=1) & np.isfinite(u).all(axis=1) & (confidence > 0)
    trusted = known & solves & (confidence >= _MIN_CONFIDENCE)
    inside = _inside(points2d_px, camera)
    cut = _cut(trusted, inside)
    used = trusted & inside
    if used.sum() < _MIN_JOINTS:
        few = f"few joints: {used.sum()} of {solves.sum()} are seen, {_MIN_JOINTS} are needed"
        return AbsolutePose.missing(n_joints, cut or few)
    least_ratio = _FIT_RATIO if landmarks_are_projections else 0.0
    found = _translation(relative_m[used], u[used], confidence[used], sigma_m[used], least_ratio)
    depth_m = relative_m[:, 2] + found.t_m[2]
    failure = _failure(found, float(np.mean(depth_m[used])))
    if failure:
        return AbsolutePose.missing(n_joints, failure)
    known &= depth_m > _MIN_DEPTH_M
    rays = np.concatenate([u, np.ones((n_joints, 1))], axis=1)
    covariance_m2 = _covariance(rays, depth_m, sigma_m, np.where(inside, confidence, 0.0), found, camera)
    return AbsolutePose(
        np.where(known[:, None], rays * depth_m[:, None], np.nan),
        np.where(known[:, None, None], covariance_m2, np.nan),
        cut or _poor_fit(found),
    )


def confidence_of_spread(variance_m2: Float[np.ndarray, "*joints"]) -> Float[np.ndarray, "*joints"]:
    """Confidence of joints of whose positions a network tells the variance: a half at a spread of 0.1 m."""
    return 1 / (1 + variance_m2 / _HALF_CONFIDENCE_M**2)


@cache
def _depth_sigmas(
    skeleton: Skeleton | None, n_joints: int
) -> tuple[Float[np.ndarray, " joint"], Bool[np.ndarray, " joint"]]:
    """SD of the depth of each joint relative to the body, and whether it is used to find the translation."""
    sigma_m, solves = np.full(n_joints, _OTHER_DEPTH_SIGMA_M), np.zeros(n_joints, dtype=bool)
    for joint, name in enumerate(skeleton.joints if skeleton else ()):
        part = name.rsplit("_", maxsplit=1)[-1]
        if part in _DEPTH_SIGMA_M:
            sigma_m[joint], solves[joint] = _DEPTH_SIGMA_M[part], True
    # Too few joints have names that are known here: all are used.
    solves = solves if solves.sum() >= _MIN_JOINTS else np.ones(n_joints, dtype=bool)
    sigma_m.setflags(write=False)
    solves.setflags(write=False)
    return sigma_m, solves


def _inside(points2d_px: Float[np.ndarray, "joint 2"], camera: Camera) -> Bool[np.ndarray, " joint"]:
    margin_px = _BORDER_SHARE * max(camera.size_px)
    return np.all((points2d_px >= margin_px) & (points2d_px <= np.array(camera.size_px) - margin_px), axis=1)


def _cut(trusted: Bool[np.ndarray, " joint"], inside: Bool[np.ndarray, " joint"]) -> str:
    n_trusted, n_cut = int(trusted.sum()), int((trusted & ~inside).sum())
    if n_cut <= _MAX_CUT_SHARE * n_trusted:
        return ""
    return f"cut by the border: {n_cut} of {n_trusted} joints lie outside the image or at its edge"


def _translation(
    relative_m: Float[np.ndarray, "joint 3"],
    u: Float[np.ndarray, "joint 2"],
    confidence: Float[np.ndarray, " joint"],
    sigma_m: Float[np.ndarray, " joint"],
    least_ratio: float,
) -> _Translation:
    """Weighted least squares of t_xy - u t_z = u X_z - X_xy, re-weighted (Cauchy) with the residuals' own scale."""
    target_m = relative_m[:, 2:] * u - relative_m[:, :2]
    information = confidence / sigma_m**2
    t_m, spread = _least_squares(target_m, u, information)
    for _ in range(_ITERATIONS):
        normalised, ratio = _residuals(target_m, u, t_m, sigma_m)
        before, weights = t_m, information / (1.0 + (normalised / (CAUCHY_SCALE * max(ratio, _MIN_FIT_RATIO))) ** 2)
        t_m, spread = _least_squares(target_m, u, weights)
        if np.abs(t_m - before).max() < _CONVERGED_M:
            break
    n, (_, ratio) = len(u), _residuals(target_m, u, t_m, sigma_m)
    ratio = np.sqrt((n * ratio**2 + _FIT_PRIOR_JOINTS * _FIT_RATIO**2) / (n + _FIT_PRIOR_JOINTS))
    ratio = max(ratio, least_ratio)
    return _Translation(t_m, float(ratio), float(ratio / np.sqrt(spread)))


def _residuals(
    target_m: Float[np.ndarray, "joint 2"],
    u: Float[np.ndarray, "joint 2"],
    t_m: Float[np.ndarray, " 3"],
    sigma_m: Float[np.ndarray, " joint"],
) -> tuple[Float[np.ndarray, " joint"], float]:
    """Length of each residual as a multiple of the joint's sigma, and their robust size per axis."""
    residual_m = target_m - t_m[:2] + u * t_m[2]
    normalised = np.sqrt(np.einsum("ji,ji->j", residual_m, residual_m)) / sigma_m
    middle = len(u) // 2  # np.median takes ten times as long, half of the whole solve
    return normalised, float(np.partition(normalised, middle)[middle]) / MEDIAN_LENGTH


def _least_squares(
    target_m: Float[np.ndarray, "joint 2"], u: Float[np.ndarray, "joint 2"], weights: Float[np.ndarray, " joint"]
) -> tuple[Float[np.ndarray, " 3"], float]:
    """The translation, and the information about t_z: it comes from the spread of the joints in the image."""
    weights_sum = weights.sum()
    mean_u, mean_m = weights @ u / weights_sum, weights @ target_m / weights_sum
    centred = u - mean_u
    spread = max(float(np.sum(weights @ centred**2)), _MIN_SPREAD)
    t_z = -float(np.sum(weights @ (centred * (target_m - mean_m)))) / spread
    return np.array([*(mean_m + mean_u * t_z), t_z]), spread


def _failure(found: _Translation, distance_m: float) -> str:
    if distance_m <= _MIN_DEPTH_M:
        return f"behind the camera: the joints fit their landmarks from a depth of {distance_m:.2f} m"
    if found.distance_sigma_m > _MAX_DISTANCE_SIGMA * distance_m:
        return f"ill-conditioned: the distance of {distance_m:.2f} m is known to {found.distance_sigma_m:.2f} m"
    return ""


def _poor_fit(found: _Translation) -> str:
    if found.fit_ratio <= _MAX_FIT_RATIO:
        return ""
    return f"poor fit: 3D and 2D joints disagree {found.fit_ratio / _FIT_RATIO:.1f} times as much as usual"


def _covariance(
    rays: Float[np.ndarray, "joint 3"],
    depth_m: Float[np.ndarray, " joint"],
    sigma_m: Float[np.ndarray, " joint"],
    confidence: Float[np.ndarray, " joint"],
    found: _Translation,
    camera: Camera,
) -> Float[np.ndarray, "joint 3 3"]:
    """The first-order covariance of depth * (u, 1), from independent errors of the depth and of u. Beyond the border
    the confidence is 0."""
    sigma_m = sigma_m * max(1.0, found.fit_ratio / _FIT_RATIO)
    depth_variance = found.distance_sigma_m**2 + (_SCALE_SIGMA * depth_m) ** 2 + sigma_m**2
    landmark_variance = _LATERAL_SIGMA_M**2 + (_PIXEL_SIGMA_PX * depth_m / camera.K[0, 0]) ** 2
    # The error of a hallucinated landmark (out of sight, beyond the border) across the ray is at most that of the
    # network's depth along it.
    lateral_variance = landmark_variance / np.maximum(confidence, landmark_variance / sigma_m**2)
    along = depth_variance[:, None, None] * rays[:, :, None] * rays[:, None, :]
    return along + lateral_variance[:, None, None] * np.diag([1.0, 1.0, 0.0])
