"""Joints that stand at (0, 0): what some programs write for those that they did not find."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Bool

from fgpose.io.keypoints.detections import CameraDetections, ImageDetections


def without_zeros(cameras: Mapping[str, CameraDetections]) -> tuple[dict[str, CameraDetections], tuple[str, ...]]:
    """Without the detections in the corner of the image, and in words how many they were: to the last digit no network
    finds a joint there, but their confidence says that it has."""
    images = [image for own in cameras.values() for image in own.values()]
    n_given = sum(int((image.confidence > 0).sum()) for image in images)
    n_zero = sum(int(_zero(image).sum()) for image in images)
    if not n_zero:
        return dict(cameras), ()
    share = f"{n_zero} of {n_given} keypoints stand at exactly (0, 0)"
    remark = f"{share}, with a confidence above 0: they are taken for missing"
    return {name: {frame: _blanked(image) for frame, image in own.items()} for name, own in cameras.items()}, (remark,)


def _zero(image: ImageDetections) -> Bool[np.ndarray, "person joint"]:
    return np.asarray((image.points2d_px == 0).all(axis=-1))


def _blanked(image: ImageDetections) -> ImageDetections:
    zero = _zero(image)
    points2d_px = np.where(zero[..., None], np.nan, image.points2d_px)
    return replace(image, points2d_px=points2d_px, confidence=np.where(zero, 0.0, image.confidence))
