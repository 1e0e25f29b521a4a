"""The detections of one image, checked while the file that they come from is known."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from fgpose.io.content import read_content
from fgpose.skeleton import Skeleton

# Scores that are peaks of a heat map exceed 1 a little; more than this is a percentage or another mistake.
_MAX_SCORE = 1.1

# Frame numbers are counters; longer ones overflow the arithmetic on them, and are identifiers.
MAX_FRAME = 10**15


@dataclass(frozen=True)
class ImageDetections:
    """The people found in one image; NaN = missing, then with confidence 0."""

    points2d_px: Float[np.ndarray, "person joint 2"]
    confidence: Float[np.ndarray, "person joint"]
    points3d: Float[np.ndarray, "person joint 3"] | None = None
    """As in the file: its own unit and frame."""


CameraDetections = dict[int, ImageDetections]
"""The images of one camera by frame number."""


@dataclass(frozen=True)
class Source:
    """Where numbers come from, for messages."""

    path: Path
    camera: str
    frame: int | None = None

    def __str__(self) -> str:
        frame = "" if self.frame is None else f", frame {self.frame}"
        return f"{self.path}, camera {self.camera}{frame}"


def nobody(skeleton: Skeleton) -> ImageDetections:
    """An image without people."""
    return ImageDetections(np.empty((0, skeleton.n_joints, 2)), np.empty((0, skeleton.n_joints)))


def read_json(source: Source) -> Any:
    """The document in a JSON file. Raises ValueError, naming file, camera and frame, if it is damaged."""
    try:
        return json.loads(read_content(source.path))
    # ValueError: also of text that is not UTF-8, and of numbers with thousands of digits.
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{source}: not JSON, or a truncated file: {error}") from None


def frame_number(source: Source, name: str) -> int:
    """The last number in a name: cam01_000000000012_keypoints is frame 12. Raises ValueError if there is none."""
    digits = re.findall(r"[0-9]+", name)
    if not digits or len(digits[-1].lstrip("0")) >= len(str(MAX_FRAME)):
        raise ValueError(f"{source}: no frame number in the name {name!r}")
    return int(digits[-1])


def detections_from_triples(source: Source, skeleton: Skeleton, people: list[Any]) -> ImageDetections:
    """People given as flat lists x, y, confidence per joint, an empty list for one without a body.

    Raises:
        ValueError: a list does not fit the skeleton, or a number is impossible.
    """
    triples = np.full((len(people), skeleton.n_joints, 3), np.nan)
    for person, flat in enumerate(people):
        values = numbers(source, f"the keypoints of person {person}", flat).ravel()
        if values.size not in (0, 3 * skeleton.n_joints):
            raise ValueError(
                f"{source}: person {person} has {values.size / 3:g} keypoints of x, y, confidence; "
                f"skeleton {skeleton.name} has {skeleton.n_joints} joints"
            )
        if values.size:
            triples[person] = values.reshape(-1, 3)
    return checked_detections(source, skeleton, triples[..., :2], triples[..., 2])


def checked_detections(
    source: Source, skeleton: Skeleton, points2d_px: Any, confidence: Any, points3d: Any = None
) -> ImageDetections:
    """Detections whose missing joints are NaN with confidence 0.

    Raises:
        ValueError: the number of joints is not the skeleton's, a number is infinite, a confidence outside [0, 1]; the
            message names file, camera, frame and joint.
    """
    points2d_px = numbers(source, "the 2D points", points2d_px)
    confidence = numbers(source, "the confidence", confidence)
    n_people = len(points2d_px)
    for what, array, size in (("2D points", points2d_px, (2,)), ("scores", confidence, ())):
        _check_shape(source, skeleton, what, array, (n_people, skeleton.n_joints, *size))
    _refuse_joint(source, skeleton, np.isinf(points2d_px).any(axis=-1), "a pixel that is infinite")
    known = np.isfinite(points2d_px).all(axis=-1) & ~np.isnan(confidence)
    outside = known & ~((confidence >= 0) & (confidence <= _MAX_SCORE))
    first = confidence[outside][:1]
    _refuse_joint(
        source, skeleton, outside, f"a confidence outside [0, 1]: {', '.join(f'{value:g}' for value in first)}"
    )
    confidence = np.where(known, np.minimum(confidence, 1.0), 0.0)
    points2d_px = np.where(confidence[..., None] > 0, points2d_px, np.nan)
    if points3d is not None:
        points3d = numbers(source, "the 3D points", points3d)
        _check_shape(source, skeleton, "3D points", points3d, (n_people, skeleton.n_joints, 3))
        _refuse_joint(source, skeleton, np.isinf(points3d).any(axis=-1), "a 3D coordinate that is infinite")
    return ImageDetections(points2d_px, confidence, points3d)


def numbers(source: Source, what: str, value: Any) -> np.ndarray:
    """An array of what a file has; null is NaN. Raises ValueError for anything but numbers, or ragged lists of them."""
    try:
        array = np.array(value)
        if array.dtype.kind not in "OfiuV" and array.size:
            raise TypeError(f"{array.dtype} is no type of numbers")
        return array.astype(float)  # lists with null are objects
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{source}: {what} are not numbers, or not equally many for every joint") from None


def _check_shape(source: Source, skeleton: Skeleton, what: str, array: np.ndarray, shape: tuple[int, ...]) -> None:
    if array.shape != shape:
        raise ValueError(
            f"{source}: the {what} of {shape[0]} people must be {shape} for the {skeleton.n_joints} joints of skeleton "
            f"{skeleton.name}, got {array.shape}"
        )


def _refuse_joint(source: Source, skeleton: Skeleton, bad: np.ndarray, what: str) -> None:
    if bad.any():
        person, joint = np.argwhere(bad)[0]
        raise ValueError(f"{source}, joint {skeleton.joints[joint]}: person {person} has {what}")
