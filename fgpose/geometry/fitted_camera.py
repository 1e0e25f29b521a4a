"""The camera of images whose size differs from that of its calibration."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np

from fgpose.geometry.camera import Camera

# Video encoders work on blocks of 16 x 16 px: they pad an image on the right and at the bottom, or drop what is left.
BLOCK_PX = 16
# Rounding of a resized image to whole pixels changes its aspect ratio by less; cropping usually by more.
_ASPECT_TOLERANCE = 0.01


def fitted_camera(camera: Camera, size_px: tuple[int, int], where: str | Path) -> Camera:
    """The camera of images whose size differs from that of its calibration.

    - At most 16 px wider, narrower, higher or lower: the encoder cut or padded the image on the right and at the
      bottom, as they do to fill blocks of 16 x 16. The intrinsics are unchanged. (Two cameras of Pose2Sim's
      demonstration have 1080 px and were calibrated with 1088. This assumption gives the lowest reprojection errors of
      BlazePose, with a mean of 12.8 px; 13.4 if the image were resized, 13.6 if cut on both sides, 14.5 on the left.)
    - Otherwise the same aspect ratio within 1 %: the image was resized, so the intrinsics are scaled.
    - Otherwise it is not known which part of the image is left.

    Args:
        camera: as calibrated.
        size_px: width and height of the images.
        where: the file, for messages.

    Warns:
        UserWarning: the size differs; it says what was assumed.

    Raises:
        ValueError: the size cannot be explained.
    """
    if size_px == camera.size_px:
        return camera
    ratio = np.divide(size_px, camera.size_px)
    sizes = f"the images are {size_px[0]} x {size_px[1]}, the calibration is for {camera.size_px[0]} x " + str(
        camera.size_px[1]
    )
    if np.abs(np.subtract(size_px, camera.size_px)).max() <= BLOCK_PX:
        warnings.warn(
            f"{where}, camera {camera.name}: {sizes}; taken to be cut or padded on the right and at the bottom",
            stacklevel=2,
        )
        return replace(camera, size_px=size_px)
    if abs(ratio[0] / ratio[1] - 1) > _ASPECT_TOLERANCE:
        raise ValueError(
            f"{where}, camera {camera.name}: {sizes}; neither a resized image nor one without its border: "
            "calibrate the camera with images of this size"
        )
    warnings.warn(
        f"{where}, camera {camera.name}: {sizes}; taken to be resized by {ratio[0]:.4g} x {ratio[1]:.4g}", stacklevel=2
    )
    K = camera.K.copy()
    K[:2] *= ratio[:, None]
    # The middle of the first pixel is at 0, its corner at -0.5: corners are what is scaled.
    K[:2, 2] += (ratio - 1) / 2
    return replace(camera, size_px=size_px, K=K)
