"""One person drawn into one image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from fgpose.geometry.camera import Camera
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Status
from fgpose.viewer.rerun.palette import Colour, person_colour

_OUTLINE: Colour = (0, 0, 0)
_OF_ELLIPSES: Colour = (255, 255, 255)  # no person's
_STEP_M = 1e-4  # for derivatives of the projection, whose curvature does not matter at this distance
_CONFIDENCE_95 = 2.4477  # root of the 95 % quantile of chi-square with 2 degrees of freedom
_SHIFT = 4  # OpenCV's fractional bits of coordinates


@dataclass(frozen=True, eq=False)
class Pose:
    """Somebody at the time of an image."""

    person: int
    positions_m: Float[np.ndarray, "joint 3"]
    """NaN: not estimated."""
    status: Int[np.ndarray, " joint"]
    covariance_m2: Float[np.ndarray, "joint 3 3"] | None


class Drawing:
    """Draws people into the images of a camera. Joints that are predicted are hollow, their bones dashed.

    Args:
        skeleton: of the people.
        ellipses: where a joint is with 95 %, as an ellipse around it.
        numbers: the number of each person above the topmost joint that is observed.
    """

    def __init__(self, skeleton: Skeleton, *, ellipses: bool, numbers: bool) -> None:
        self._skeleton, self._ellipses, self._numbers = skeleton, ellipses, numbers

    def add(self, image: UInt8[np.ndarray, "height width 3"], camera: Camera, pose: Pose, scale: float = 1.0) -> None:
        """Draw somebody, in place.

        Args:
            image: RGB, as the camera took it but for its scale.
            camera: that took it.
            pose: of the time at which it was taken.
            scale: pixels of this image per pixel of the camera.
        """
        points_px = scale * camera.distort(camera.project(pose.positions_m))
        height, width = image.shape[:2]
        # Far outside, a projection has no meaning, and OpenCV takes whole numbers of 32 bits.
        points_px[~(np.abs(points_px - [width / 2, height / 2]) < 2 * max(width, height)).all(axis=-1)] = np.nan
        colour, thin = person_colour(pose.person), max(1, round(height / 400))
        predicted = np.asarray(pose.status) != Status.OBSERVED
        bones = (*self._skeleton.bones, *self._skeleton.lines)
        for fill, width_px in ((_OUTLINE, thin + 2), (colour, thin)):
            for start, end in bones:
                dashed = predicted[start] or predicted[end]
                _line(image, points_px[[start, end]], fill, width_px, 6 * thin if dashed else None)
        for point_px, hollow in zip(points_px, predicted, strict=True):
            _dot(image, point_px, _OUTLINE if hollow else colour, colour, thin)
        # Above the dots, which cover those of well known joints.
        if self._ellipses and pose.covariance_m2 is not None:
            jacobian = scale * _jacobian(camera, pose.positions_m)
            covariances_px2 = np.einsum("jai,jik,jbk->jab", jacobian, pose.covariance_m2, jacobian)
            fine = (thin + 1) // 2
            for fill, width_px in ((_OUTLINE, fine + 1), (_OF_ELLIPSES, fine)):
                for point_px, covariance_px2 in zip(points_px, covariances_px2, strict=True):
                    _ellipse(image, point_px, covariance_px2, fill, width_px)
        if self._numbers and (top_px := _top(points_px, predicted, (width, height))) is not None:
            _number(image, f"{pose.person}", top_px, colour, thin)


def _top(
    points_px: Float[np.ndarray, "joint 2"], predicted: Bool[np.ndarray, " joint"], size_px: tuple[int, int]
) -> Float[np.ndarray, " 2"] | None:
    """The topmost joint in the image, of those that are observed if there are any: others may be far from the body."""
    inside = ((points_px >= 0) & (points_px < size_px)).all(axis=-1)
    chosen = points_px[inside & ~predicted] if (inside & ~predicted).any() else points_px[inside]
    return chosen[chosen[:, 1].argmin()] if len(chosen) else None


def caption(image: UInt8[np.ndarray, "height width 3"], text: str) -> None:
    """Written into the upper left corner, in place."""
    thin = max(1, round(image.shape[0] / 400))
    _text(image, text, np.array([8.0 * thin, 16.0 * thin]), (255, 255, 255), thin)


def _jacobian(camera: Camera, positions_m: Float[np.ndarray, "joint 3"]) -> Float[np.ndarray, "joint 2 3"]:
    """Of original pixels by the position, px/m."""
    steps_m = _STEP_M * np.eye(3)
    ahead, behind = (camera.distort(camera.project(positions_m[:, None] + sign * steps_m)) for sign in (1, -1))
    return np.swapaxes(ahead - behind, 1, 2) / (2 * _STEP_M)


def _ellipse(
    image: np.ndarray, point_px: np.ndarray, covariance_px2: Float[np.ndarray, "2 2"], colour: Colour, width_px: int
) -> None:
    import cv2

    if not (np.isfinite(point_px).all() and np.isfinite(covariance_px2).all()):
        return
    variances_px2, axes = np.linalg.eigh(covariance_px2)
    sizes_px = _CONFIDENCE_95 * np.sqrt(np.maximum(variances_px2, 0.0))
    # One that is larger than the image says that nothing is known.
    if sizes_px[1] < max(image.shape):
        angle_deg = np.degrees(np.arctan2(axes[1, 1], axes[0, 1]))
        center, size = _fixed(point_px), _fixed(sizes_px[::-1])
        cv2.ellipse(image, center, size, float(angle_deg), 0, 360, colour, width_px, cv2.LINE_AA, _SHIFT)


def _line(
    image: np.ndarray, ends_px: Float[np.ndarray, "2 2"], colour: Colour, width_px: int, dash_px: int | None
) -> None:
    """From one end to the other, in dashes as long as the gaps between them if dash_px says how long."""
    import cv2

    if not np.isfinite(ends_px).all():
        return
    start_px, along_px = ends_px[0], ends_px[1] - ends_px[0]
    n_pieces = 1 if dash_px is None else 2 * round(np.linalg.norm(along_px) / dash_px / 2) + 1
    for piece in range(0, n_pieces, 2):
        first, last = start_px + piece / n_pieces * along_px, start_px + (piece + 1) / n_pieces * along_px
        cv2.line(image, _fixed(first), _fixed(last), colour, width_px, cv2.LINE_AA, _SHIFT)


def _dot(image: np.ndarray, point_px: np.ndarray, fill: Colour, rim: Colour, thin: int) -> None:
    import cv2

    if np.isfinite(point_px).all():
        for radius_px, colour in ((2 * thin + 2, _OUTLINE), (2 * thin + 1, rim), (2 * thin - 1, fill)):
            cv2.circle(image, _fixed(point_px), radius_px << _SHIFT, colour, -1, cv2.LINE_AA, _SHIFT)


def _number(image: np.ndarray, text: str, below_px: np.ndarray, colour: Colour, thin: int) -> None:
    """Above a joint, or as high as the image allows."""
    import cv2

    (width_px, height_px), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.5 * thin, thin)
    left_bottom_px = below_px - [width_px / 2, 5 * thin]
    _text(image, text, np.maximum(left_bottom_px, [thin, height_px + thin]), colour, thin)


def _text(image: np.ndarray, text: str, left_bottom_px: np.ndarray, colour: Colour, thin: int) -> None:
    import cv2

    at = int(left_bottom_px[0]), int(left_bottom_px[1])
    for width_px, fill in ((3 * thin, _OUTLINE), (thin, colour)):
        cv2.putText(image, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.5 * thin, fill, width_px, cv2.LINE_AA)


def _fixed(pair: np.ndarray) -> tuple[int, int]:
    """In OpenCV's fixed point."""
    first, second = np.round(pair * (1 << _SHIFT)).astype(int).tolist()
    return first, second
