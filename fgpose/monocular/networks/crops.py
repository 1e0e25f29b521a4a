"""Square, turned regions of an image: what a network sees of it, and the way back to the pixels of the image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from fgpose.monocular.network import Image

_BORDERS = {"replicate": cv2.BORDER_REPLICATE, "black": cv2.BORDER_CONSTANT}


@dataclass(frozen=True)
class Region:
    """A square of the image that a network sees upright. It may reach beyond the image."""

    center_px: tuple[float, float]
    side_px: float
    angle_rad: float = 0.0
    """Angle from up in the image to up in the square, clockwise in the image."""

    @staticmethod
    def whole(size_px: tuple[int, int]) -> Region:
        """The smallest upright square around an image of this width and height: the centred letterbox."""
        return Region((size_px[0] / 2, size_px[1] / 2), float(max(size_px)))

    @staticmethod
    def around(
        center_px: Float[np.ndarray, " 2"] | Sequence[float],
        top_px: Float[np.ndarray, " 2"] | Sequence[float],
        scale: float,
    ) -> Region:
        """The square around a circle, enlarged by scale; the circle has this centre, and passes through its top."""
        x, y = np.subtract(top_px, center_px).tolist()
        angle_rad = np.pi / 2 - np.arctan2(-y, x)
        return Region((float(center_px[0]), float(center_px[1])), float(2 * scale * np.hypot(x, y)), float(angle_rad))

    @property
    def rotation(self) -> Float[np.ndarray, "2 2"]:
        """Takes directions of the upright crop to the image."""
        cos, sin = np.cos(self.angle_rad), np.sin(self.angle_rad)
        return np.array([[cos, -sin], [sin, cos]])

    def crop_T_image(self, size: int) -> Float[np.ndarray, "2 3"]:
        """Affine map of pixels of the image to those of a crop, size by size; the centres of both coincide."""
        linear = size / self.side_px * self.rotation.T
        return np.column_stack([linear, size / 2 - linear @ self.center_px])

    def crop(
        self, image: Image, size: int, border: Literal["replicate", "black"] = "replicate"
    ) -> UInt8[np.ndarray, "size size 3"]:
        """What the square shows, size by size pixels, bilinear; border is what lies beyond the image."""
        return cv2.warpAffine(
            image, self.crop_T_image(size), (size, size), flags=cv2.INTER_LINEAR, borderMode=_BORDERS[border]
        )

    def to_image(self, points_crop: Float[np.ndarray, "*points 2"], size: int) -> Float[np.ndarray, "*points 2"]:
        """Pixels of the image of points in a crop of this size."""
        return (points_crop - size / 2) * (self.side_px / size) @ self.rotation.T + self.center_px
