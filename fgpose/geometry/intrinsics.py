"""Cameras whose poses are not known: intrinsics alone, each camera in a world frame of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from fgpose.geometry.camera import Camera, CameraRig

# Focal lengths of films, as a share of the longer side of the image: webcams and action cameras 0.5 to 0.75, phones
# 0.75 to 0.9 (a lens of 26 mm, cropped by the stabilisation), camcorders and cinema lenses 0.85 to 1.3. With this one
# nearly all are within 40 %, which is what calibration from people is made to correct. Known cameras of our
# recordings: 0.50, 0.50, 0.55, 0.70 (webcams), 0.88 (four of a laboratory).
_FOCAL_SHARE = 0.85
# The principal point of every camera known to us lies within 5 % of the image's width of its middle. Beyond a quarter
# the image was cut, or K is for images of another size; so it is with a tenth of both sides to the right and down, or
# to the left and up, as K of 1280 x 720 is for 1920 x 1080.
_USUALLY_OFF_CENTRE, _MAX_OFF_CENTRE, _MAX_OFF_BOTH = 0.06, 0.25, 0.1


def without_pose(camera: Camera) -> Camera:
    """The camera at the origin of its own frame (x right, y down, z forward), with a clock that is not off."""
    return replace(camera.unchanging(), world_T_camera=np.eye(4))


def zoomed(camera: Camera, factor: float) -> Camera:
    """The camera with a focal length that is so many times as long."""
    K = camera.K.copy()
    K[[0, 1], [0, 1]] *= factor
    return replace(camera, K=K)


def stretched(camera: Camera, factor: float, axis: int) -> Camera:
    """The camera with a focal length along one axis of the image that is so many times as long."""
    K = camera.K.copy()
    K[axis, axis] *= factor
    return replace(camera, K=K)


def shifted(camera: Camera, by: float, axis: int) -> Camera:
    """The camera with a principal point that is further along one axis of the image, by so many focal lengths."""
    K = camera.K.copy()
    K[axis, 2] += by * K[axis, axis]
    return replace(camera, K=K)


def with_exchanged_centre(camera: Camera) -> Camera:
    """The camera with cx for cy."""
    K = camera.K.copy()
    K[:2, 2] = K[1::-1, 2]
    return replace(camera, K=K)


def is_central(camera: Camera) -> bool:
    """Whether the principal point is where that of nearly every lens is."""
    return bool((np.abs(_off_centre(camera)) < _USUALLY_OFF_CENTRE).all())


def is_of_another_size(camera: Camera) -> bool:
    """Whether the principal point is so far from the middle of the image that K seems to be for images of another size,
    or for the whole image where this is a part."""
    share = _off_centre(camera)
    of_both = np.abs(share).min() if share[0] * share[1] > 0 else 0.0
    return bool(np.abs(share).max() > _MAX_OFF_CENTRE or of_both > _MAX_OFF_BOTH)


def _off_centre(camera: Camera) -> Float[np.ndarray, " 2"]:
    """As a share of width and height."""
    return np.asarray((camera.K[:2, 2] - middle_px(camera)) / camera.size_px)


def middle_px(camera: Camera) -> Float[np.ndarray, " 2"]:
    """Of its images; the middle of the first pixel is at 0."""
    return (np.array(camera.size_px) - 1) / 2


UNKNOWN_SIZE_PX = (1, 1)
"""Of the images of cameras of which nothing but the names is known."""


def guessed_intrinsics(
    names: Sequence[str], sizes_px: Sequence[tuple[int, int]], focal_px: float | None = None
) -> CameraRig:
    """Cameras of which only the size of the images is known: identity poses and no distortion.

    The principal point is the middle of the image, where it is within some per cent of the width in most cameras; from
    people it cannot be told. Without focal_px the focal length is 0.85 times the longer side of the image (61 degrees),
    the middle of what people film with: to be estimated, not to be trusted. Images of one size get the same.

    Args:
        names: of the cameras.
        sizes_px: width and height of the images of each.
        focal_px: focal length of all of them, if it is known, pixels.

    Raises:
        ValueError: there is no camera, two have the same name, a size or the focal length is not positive, or the
            number of names and sizes differ.
    """
    if len(names) != len(sizes_px):
        raise ValueError(f"{len(names)} cameras need as many image sizes, got {len(sizes_px)}")
    if focal_px is not None and not 0 < focal_px < np.inf:
        raise ValueError(f"the focal length must be a positive number of pixels, got {focal_px:g}")
    pairs = zip(names, sizes_px, strict=True)
    return CameraRig(tuple(_guessed(name, size_px, focal_px) for name, size_px in pairs))


def _guessed(name: str, size_px: tuple[int, int], focal_px: float | None) -> Camera:
    width, height = size_px
    focal = _FOCAL_SHARE * max(size_px) if focal_px is None else focal_px
    # The middle of the first pixel is at 0.
    K = np.array([[focal, 0.0, (width - 1) / 2], [0.0, focal, (height - 1) / 2], [0.0, 0.0, 1.0]])
    return Camera(name, (width, height), K, np.eye(4), np.zeros(0))
