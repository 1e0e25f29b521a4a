"""Shared by all top-down networks: a detector finds people, and a network gets a crop of each."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float

from fgpose.geometry.camera import Camera
from fgpose.monocular.network import Image, People, checked_image
from fgpose.monocular.networks.sessions import Shape

Box = Float[np.ndarray, " 5"]
Boxes = Float[np.ndarray, "person 5"]
"""Left, top, width, height in pixels of the image, and confidence in [0, 1]."""

# While following: a joint counts from here on (mmpose draws from 0.3), and half of the joints make a person.
_MIN_CONFIDENCE = 0.3
_MIN_SHARE = 0.5
# The joints do not reach to the top of the head, the fingertips and the soles, but networks are trained on boxes of
# whole people.
_JOINTS_TO_PERSON = 1.25
# Newcomers are found, and boxes that have become too small corrected, after this many images at the latest.
_DETECT_EVERY = 10
# Lower, one of two people who stand behind each other is dropped; higher, one person is followed twice.
_SAME_PERSON_OVERLAP = 0.65
_MIN_SIDE_PX = 1.0  # smaller boxes have no pixels to crop


@runtime_checkable
class PersonDetector(Protocol):
    """Finds people in an image. May be used from several threads at once."""

    name: str
    """Model, file and settings: differs if results may differ."""

    def boxes(self, image: Image) -> Boxes:
        """The people in an image, the most confident first."""
        ...


@dataclass(frozen=True)
class TopDown:
    """Where the boxes of a top-down network come from.

    Raises:
        ValueError: max_people is below 1.
    """

    detector: PersonDetector
    max_people: int
    """How many people are looked at in an image, the most confident first."""
    detect_every_frame: bool
    """False: boxes follow the joints, see TopDownTracker."""

    def __post_init__(self) -> None:
        if self.max_people < 1:
            raise ValueError(f"max_people must be at least 1, got {self.max_people}")

    @property
    def name(self) -> str:
        """Of the detector and the settings, for a network's name."""
        return f"{self.max_people} {'detected' if self.detect_every_frame else 'followed'} by {self.detector.name}"


class TopDownTracker:
    """The people in the images of one camera, each seen in the crop around a box.

    The boxes come from the detector. Without detect_every_frame the detector only runs in every tenth image, and in the
    image after somebody was lost; in between the boxes come from the joints in the image before, as in mmpose. This
    works as long as most joints are seen: a person who moves by less than an eighth of their size between two images
    stays in the crop. But somebody who enters is seen up to ten images late. And if half of a person is hidden, the box
    may shrink to the half that is seen, until the next detection.
    """

    def __init__(
        self, top_down: TopDown, poses: Callable[[Image, Boxes], People], camera: Camera, n_joints: int
    ) -> None:
        """poses: the people in an image, one for each box and in their order."""
        self._camera = camera
        self._detector, self._max_people = top_down.detector, top_down.max_people
        self._detect_every = 1 if top_down.detect_every_frame else _DETECT_EVERY
        self._poses, self._n_joints = poses, n_joints
        self._followed: Boxes | None = None
        self._since_detection = 0

    def detect(self, image: np.ndarray) -> People:
        """The people in the next image, the most confident first.

        Raises:
            ValueError: the image is not (height, width, 3) uint8 of the camera's size; the message names the camera.
        """
        image = checked_image(image, self._camera)
        boxes = self._next_boxes(image)
        people = self._poses(image, boxes) if len(boxes) else People.nobody(self._n_joints)
        self._followed = follow(people, self._camera.size_px)
        return people

    def _next_boxes(self, image: Image) -> Boxes:
        self._since_detection += 1
        if self._followed is not None and self._since_detection < self._detect_every:
            return self._followed
        self._since_detection = 0
        boxes = usable(self._detector.boxes(image))
        return boxes[_in_image(boxes, self._camera.size_px)][: self._max_people]


def usable(boxes: Boxes) -> Float[np.ndarray, "usable 5"]:
    """Boxes that have an area, the most confident first."""
    boxes = boxes[np.isfinite(boxes).all(axis=1) & (boxes[:, 2:4] >= _MIN_SIDE_PX).all(axis=1)]
    return boxes[np.argsort(-boxes[:, 4], kind="stable")]


def _in_image(boxes: Boxes, size_px: tuple[int, int]) -> Bool[np.ndarray, " person"]:
    inside_px = np.minimum(boxes[:, :2] + boxes[:, 2:4], size_px) - np.maximum(boxes[:, :2], 0)
    return np.all(inside_px >= _MIN_SIDE_PX, axis=1)


def follow(people: People, size_px: tuple[int, int]) -> Boxes | None:
    """Boxes for the next image from the joints in this one, or None when a detector has to look."""
    boxes = [_box_of_joints(*person, size_px) for person in zip(people.points2d_px, people.confidence, strict=True)]
    found = [np.array([*box, score]) for box, score in zip(boxes, people.boxes[:, 4], strict=True) if box is not None]
    if not found or len(found) < len(boxes):
        return None
    stacked = np.stack(found)
    # Two boxes that have drifted to the same person would stay there.
    return stacked[suppress(stacked, _SAME_PERSON_OVERLAP)]


def _box_of_joints(
    points2d_px: Float[np.ndarray, "joint 2"], confidence: Float[np.ndarray, " joint"], size_px: tuple[int, int]
) -> Float[np.ndarray, " 4"] | None:
    trusted = confidence >= _MIN_CONFIDENCE
    if trusted.mean() < _MIN_SHARE:
        return None
    low, high = points2d_px[trusted].min(axis=0), points2d_px[trusted].max(axis=0)
    center, half = (low + high) / 2, (high - low) / 2 * _JOINTS_TO_PERSON
    low, high = np.clip(center - half, 0, size_px), np.clip(center + half, 0, size_px)
    return np.concatenate([low, high - low]) if np.all(high - low >= _MIN_SIDE_PX) else None


def suppress(boxes: Boxes, max_overlap: float) -> Bool[np.ndarray, " person"]:
    """Non-maximum suppression: which boxes stay, the most confident first to choose.

    Args:
        boxes: in the order of their confidence.
        max_overlap: intersection over union from which the less confident of two boxes is removed.
    """
    low, size = boxes[:, :2], boxes[:, 2:4]
    corner = np.minimum(low[:, None] + size[:, None], low + size) - np.maximum(low[:, None], low)
    shared = np.prod(np.clip(corner, 0, None), axis=-1)
    area = np.prod(size, axis=-1)
    overlap = shared / np.maximum(area[:, None] + area - shared, np.finfo(float).tiny)
    stays = np.ones(len(boxes), dtype=bool)
    for box in range(len(boxes)):
        stays[box] = not (overlap[box, :box] > max_overlap)[stays[:box]].any()
    return stays


def by_order(nodes: Sequence[Any], expected: Mapping[str, Shape]) -> Mapping[str, Shape]:
    """The expected shapes under the names that a file gives its inputs or outputs, which the exporter chooses.

    If the numbers differ, the expected names stay, so that the error message shows them.

    Args:
        nodes: onnxruntime's, in the order of the file.
        expected: shapes in that order, by their usual names.
    """
    if len(nodes) != len(expected):
        return expected
    return {node.name: shape for node, shape in zip(nodes, expected.values(), strict=True)}
