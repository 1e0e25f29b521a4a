"""One camera's pictures as a recording shows them: small, undistorted, compressed, up to a limit."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import UInt8

from fgpose.geometry.camera import Camera


@dataclass(frozen=True)
class PictureOptions:
    """How large the pictures of a recording may be; see open_recording.

    Raises:
        ValueError: an option is out of its range.
    """

    image_width_px: int | None
    jpeg_quality: int
    image_limit_mb: float | None
    n_frames: int | None
    every: int = 1
    images_every: int | None = None

    def __post_init__(self) -> None:
        for name in ("image_width_px", "image_limit_mb", "n_frames", "every", "images_every"):
            value = getattr(self, name)
            if value is not None and value <= 0:
                raise ValueError(f"{name} must be positive, got {value}")
        if not 1 <= self.jpeg_quality <= 100:
            raise ValueError(f"jpeg_quality must be from 1 to 100, got {self.jpeg_quality}")


class CameraPictures:
    """Prepares one camera's pictures and counts their bytes.

    A picture is shrunk by a whole factor, so that its pixels are the means of blocks of the original ones, and is then
    undistorted into the pinhole image with the same K.

    Args:
        camera: that took them.
        options: of the recording.
        n_cameras: among which the recording's limit is divided.
        size_px: of the pictures that are given, if they have been scaled.
    """

    def __init__(
        self, camera: Camera, options: PictureOptions, n_cameras: int, size_px: tuple[int, int] | None = None
    ) -> None:
        self._camera = camera
        self._options = options
        self._limit_bytes = math.inf if options.image_limit_mb is None else options.image_limit_mb * 1e6 / n_cameras
        self._used_bytes = self._last_bytes = 0
        self.size_px = camera.size_px if size_px is None else size_px
        """Of the pictures that are given."""
        width_px = self.size_px[0]
        self._shrink = min(math.ceil(width_px / (options.image_width_px or width_px)), *self.size_px)
        width, height = (self._shrink * own / given for own, given in zip(camera.size_px, self.size_px, strict=True))
        self.scale = width, height
        """Undistorted pixels per pixel of the picture, across and down."""

    @property
    def full(self) -> bool:
        """Whether the last picture exceeded the limit; no other will be shown."""
        return self._used_bytes > self._limit_bytes

    def wants(self, frame: int) -> bool:
        """Whether the picture of a frame is shown, and within the limit.

        Where the number of frames is known, pictures are thinned out evenly over the recording.
        """
        if frame % (self._options.images_every or self._options.every):
            return False
        if self._options.n_frames is None or self.full:
            return not self.full
        share = min(1.0, (frame + 1) / self._options.n_frames)
        return self._used_bytes + self._last_bytes <= share * self._limit_bytes

    def check(self, frame: int, image: UInt8[np.ndarray, "height width 3"]) -> None:
        """Raises ValueError if the size of an image differs from that of the calibration."""
        width, height = self.size_px
        if image.shape[:2] != (height, width):
            raise ValueError(
                f"camera {self._camera.name}, frame {frame}: the picture is {image.shape[1]} x {image.shape[0]}, "
                f"the calibration is for {width} x {height}"
            )

    def jpeg(self, image: UInt8[np.ndarray, "height width 3"]) -> bytes:
        """The picture of an RGB image, as the bytes of a JPEG file; they are counted."""
        import cv2

        picture = cv2.cvtColor(self._undistorted(self._shrunk(image)), cv2.COLOR_RGB2BGR)
        encoded = cv2.imencode(".jpg", picture, (cv2.IMWRITE_JPEG_QUALITY, self._options.jpeg_quality))[1].tobytes()
        self._last_bytes = len(encoded)
        self._used_bytes += self._last_bytes
        return encoded

    @property
    def _shrunk_size_px(self) -> tuple[int, int]:
        """What does not fill a whole pixel at the right and lower border is left out."""
        width, height = self.size_px
        return width // self._shrink, height // self._shrink

    def _shrunk(self, image: np.ndarray) -> np.ndarray:
        if self._shrink == 1:
            return image
        import cv2

        width, height = self._shrunk_size_px
        blocks = image[: height * self._shrink, : width * self._shrink]
        return cv2.resize(blocks, (width, height), interpolation=cv2.INTER_AREA)

    def _undistorted(self, image: np.ndarray) -> np.ndarray:
        # A fisheye lens whose coefficients are all zero still maps the angle, not its tangent.
        if self._camera.lens == "pinhole" and not self._camera.distortion.any():
            return image
        import cv2

        return cv2.remap(image, *self._maps, interpolation=cv2.INTER_LINEAR)

    @cached_property
    def _maps(self) -> tuple[np.ndarray, np.ndarray]:
        """Where each pixel of the picture lies in the shrunk image, in 1/32 px: a quarter faster than floats."""
        import cv2

        camera = self._camera
        maps = cv2.fisheye.initUndistortRectifyMap if camera.lens == "fisheye" else cv2.initUndistortRectifyMap
        # The middle of the first pixel is at 0, its corner at -0.5: corners are what is scaled.
        scale = np.array(self.scale)
        K = camera.K.copy()
        K[:2] /= scale[:, None]
        K[:2, 2] -= (1 - 1 / scale) / 2
        x, y = maps(K, camera.distortion, np.eye(3), K, self._shrunk_size_px, cv2.CV_16SC2)
        return x, y
