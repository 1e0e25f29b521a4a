"""What programs write instead of a confidence in [0, 1], and of joints that they did not find."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from fgpose.io.keypoints.detections import CameraDetections, ImageDetections, refuse_confidence
from fgpose.skeleton import Skeleton

# Networks trained to give peaks of 1 (heat maps, RTMPose) exceed it; this is more than they do.
_MOST_OF_ONE = 2.0
# RTMW and DWPose are trained to give peaks of 10.
_MOST_OF_TEN = 15.0
_BETWEEN = 1.5
"""Above it the usual score is not one of a scale up to 1."""
_USUAL = 0.9
"""Quantile that is the usual score of joints that are seen: a few large ones are mistakes."""
_ROUNDING = 1e-3
_VISIBILITY = (
    "; all are 0, 1 or 2, as the visibility in annotations of COCO, which is no confidence. Give what a detector "
    "found, or write 1 for what is visible"
)


def as_confidences(
    cameras: Mapping[str, CameraDetections], skeleton: Skeleton
) -> tuple[dict[str, CameraDetections], tuple[str, ...]]:
    """All confidences of a recording in [0, 1], and in words what was done to them.

    Where scores lie about 1, those above it are 1. Those of scales up to 10 and 100 are divided by these.

    Raises:
        ValueError: the scale is none of these, or the numbers are the visibilities 0, 1 and 2 of annotations; the
            message names file, camera, frame and joint.
    """
    of_cameras = {name: _positive(own.values()) for name, own in cameras.items()}
    scores = np.concatenate([np.zeros(0), *of_cameras.values()])
    top = float(scores.max(initial=0.0))
    if top <= 1.0:
        return dict(cameras), ()
    for name, own in of_cameras.items():
        if np.isin(own, (1, 2)).all():
            _refuse_above(1.0, cameras[name].values(), skeleton, _VISIBILITY)
    # Of most cameras: one that sees little may have low scores only.
    usual = float(np.median([np.quantile(own, _USUAL) for own in of_cameras.values() if len(own)]))
    scale = 1.0 if usual <= _BETWEEN else 10.0 if top <= _MOST_OF_TEN else 100.0
    for own in cameras.values():
        _refuse_above({1.0: _MOST_OF_ONE, 10.0: _MOST_OF_TEN, 100.0: 100.0}[scale], own.values(), skeleton)
    changed = {name: {frame: _scaled(image, scale) for frame, image in own.items()} for name, own in cameras.items()}
    return changed, (_remark(scores, scale),) if top > 1 + _ROUNDING else ()


def _positive(images: Iterable[ImageDetections]) -> Float[np.ndarray, " score"]:
    scores = np.concatenate([np.zeros(0), *(image.confidence.ravel() for image in images)])
    return scores[scores > 0]


def _scaled(image: ImageDetections, scale: float) -> ImageDetections:
    return replace(image, confidence=np.minimum(image.confidence / scale, 1.0))


def _remark(scores: np.ndarray, scale: float) -> str:
    top, above = scores.max(), 100 * np.mean(scores > 1)
    if scale == 1.0:
        return f"scores of the keypoints go up to {top:.2f}, as RTMPose's do; {above:.0f} % were above 1 and count as 1"
    return f"scores of the keypoints go up to {top:.3g}; they were divided by {scale:g} to be confidences"


def _refuse_above(most: float, images: Iterable[ImageDetections], skeleton: Skeleton, remedy: str = "") -> None:
    for image in images:
        refuse_confidence(image.source, skeleton, image.confidence, image.confidence > most, remedy)


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
