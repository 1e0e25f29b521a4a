"""Lens distortion by the models of OpenCV: from pixels of the original image to those of a pinhole camera, and back."""

from __future__ import annotations

from typing import Literal

import numpy as np
from jaxtyping import Float

LensModel = Literal["pinhole", "fisheye"]
# The numbers of coefficients that OpenCV takes for each lens, without those of tilted sensors and thin prisms.
_DISTORTION_SIZES = {"pinhole": (0, 4, 5, 8), "fisheye": (4,)}
_OF_OPENCV = (12, 14)
# Where the lens model is invertible the round trip is exact to 1e-6 px; where it is not, off by tens of pixels.
_MAX_ROUND_TRIP_PX = 1.0
# cv2.TERM_CRITERIA_COUNT | EPS; 5 iterations (the default) leave 1 px at a corner.
_UNDISTORT_CRITERIA = (3, 100, 1e-10)
_AT_ONCE = 100_000  # OpenCV takes 600 bytes for each point


def check_lens(lens: str, n_coefficients: int) -> None:
    """Raise ValueError unless there is such a model with so many coefficients of distortion."""
    if lens not in _DISTORTION_SIZES:
        raise ValueError(f"unknown lens {lens!r}; known: {', '.join(_DISTORTION_SIZES)}")
    if n_coefficients not in _DISTORTION_SIZES[lens]:
        sizes = ", ".join(map(str, _DISTORTION_SIZES[lens]))
        if lens == "pinhole" and n_coefficients in _OF_OPENCV:
            raise ValueError(
                f"a pinhole lens takes {sizes} coefficients; those of thin prisms and tilted sensors, the ninth and "
                f"later of {n_coefficients}, are not supported"
            )
        raise ValueError(f"a {lens} lens takes {sizes} coefficients, got {n_coefficients}")


def without_unused(distortion: Float[np.ndarray, " coefficients"]) -> Float[np.ndarray, " used"]:
    """Of OpenCV's 12 or 14 coefficients those of the smallest model that a camera takes; all where thin prisms or
    tilted sensors are not zero."""
    if distortion.size not in _OF_OPENCV or distortion[8:].any():
        return distortion
    return distortion[:8] if distortion[5:].any() else distortion[:5]


def without_distortion(
    points_px: Float[np.ndarray, "point 2"],
    K: Float[np.ndarray, "3 3"],
    distortion: Float[np.ndarray, " coefficients"],
    lens: LensModel,
) -> Float[np.ndarray, "point 2"]:
    """Pixels of the pinhole image with the same K; NaN where the model has no inverse (far outside the calibrated
    field), and where the point is NaN."""
    undistorted_px = np.empty_like(points_px)
    for start in range(0, len(points_px), _AT_ONCE):
        part = slice(start, start + _AT_ONCE)
        undistorted_px[part] = _without_distortion(points_px[part], K, distortion, lens)
    return undistorted_px


def _without_distortion(
    points_px: Float[np.ndarray, "point 2"],
    K: Float[np.ndarray, "3 3"],
    distortion: Float[np.ndarray, " coefficients"],
    lens: LensModel,
) -> Float[np.ndarray, "point 2"]:
    """The same of so many points as memory allows at once."""
    import cv2

    known = np.isfinite(points_px).all(axis=1)
    undistorted = np.full_like(points_px, np.nan)
    if not known.any():
        return undistorted
    source = np.ascontiguousarray(points_px[known][:, None])
    if lens == "fisheye":
        image = cv2.fisheye.undistortPoints(source, K, distortion, P=K, criteria=_UNDISTORT_CRITERIA)
    else:
        image = cv2.undistortImagePoints(source, K, distortion, arg1=_UNDISTORT_CRITERIA)
    undistorted[known] = image[:, 0]
    # OpenCV's iteration returns whatever it has when there is nothing to converge to.
    round_trip_px = np.linalg.norm(with_distortion(undistorted, K, distortion, lens) - points_px, axis=1)
    undistorted[~(round_trip_px <= _MAX_ROUND_TRIP_PX)] = np.nan
    return undistorted


def with_distortion(
    points_px: Float[np.ndarray, "point 2"],
    K: Float[np.ndarray, "3 3"],
    distortion: Float[np.ndarray, " coefficients"],
    lens: LensModel,
) -> Float[np.ndarray, "point 2"]:
    """Pixels of the original image: the inverse of without_distortion."""
    import cv2

    known = np.isfinite(points_px).all(axis=1)
    distorted = np.full_like(points_px, np.nan)
    if known.any():
        rays = np.concatenate([(points_px[known] - K[:2, 2]) / np.diag(K)[:2], np.ones((known.sum(), 1))], axis=1)
        zero = np.zeros(3)
        projector = cv2.fisheye.projectPoints if lens == "fisheye" else cv2.projectPoints
        image, _ = projector(rays[:, None], zero, zero, K, distortion)
        distorted[known] = image[:, 0]
    return distorted
