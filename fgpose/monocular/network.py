"""The one interface of all networks: an image goes in, people come out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, UInt8

from fgpose.geometry.camera import Camera
from fgpose.geometry.per_view.absolute_pose import AbsolutePose
from fgpose.skeleton import Skeleton

Image = UInt8[np.ndarray, "height width 3"]
"""RGB, as the camera took it (distorted)."""


def checked_image(image: np.ndarray, camera: Camera) -> Image:
    """The image, in one piece. Raises ValueError unless it is (height, width, 3) uint8 of the camera's size."""
    width, height = camera.size_px
    if image.shape != (height, width, 3) or image.dtype != np.uint8:
        raise ValueError(
            f"camera {camera.name}: an image must be (height, width, 3) = ({height}, {width}, 3) uint8,"
            f" got {image.shape} {image.dtype}"
        )
    return np.ascontiguousarray(image)


# What rounding may add to a confidence.
_ROUNDING = 0.01


@dataclass(frozen=True, eq=False)
class People:
    """The people that a network found in one image. What is unknown of a joint is NaN, with confidence 0."""

    boxes: Float[np.ndarray, "person 5"]
    """Left, top, width, height in pixels of the original image, and confidence in [0, 1]."""
    points2d_px: Float[np.ndarray, "person joint 2"]
    """Pixels of the original, distorted image."""
    confidence: Float[np.ndarray, "person joint"]
    """In [0, 1]."""
    points3d_m: Float[np.ndarray, "person joint 3"]
    """Absolute position in the camera frame, metres; all NaN for a network that gives 2D only."""
    covariance_m2: Float[np.ndarray, "person joint 3 3"]
    """Of points3d_m, in the camera frame; NaN where that is NaN."""
    problems: tuple[str, ...] = ()
    """For each person why points3d_m is NaN or uncertain, as AbsolutePose says it: a kind, a colon, figures; empty
    where it is neither. For a network that gives 2D only, and by default, all are empty."""

    def __post_init__(self) -> None:
        if not self.problems:
            object.__setattr__(self, "problems", ("",) * self.n_people)
        if len(self.problems) != self.n_people:
            raise ValueError(f"{self.n_people} people cannot have {len(self.problems)} problems: one each, or none")

    @property
    def n_people(self) -> int:
        return len(self.boxes)

    @staticmethod
    def stacked(
        boxes: Float[np.ndarray, "person 5"],
        points2d_px: Sequence[Float[np.ndarray, "joint 2"]],
        confidence: Sequence[Float[np.ndarray, " joint"]],
        poses: Sequence[AbsolutePose],
    ) -> People:
        """From what is known of each person, one at least."""
        return People(
            boxes,
            np.stack(points2d_px),
            np.stack(confidence),
            np.stack([pose.points3d_m for pose in poses]),
            np.stack([pose.covariance_m2 for pose in poses]),
            tuple(pose.problem for pose in poses),
        )

    @staticmethod
    def nobody(n_joints: int) -> People:
        """An image without people."""
        nothing = (np.zeros((0, *shape)) for shape in People.shapes(n_joints).values())
        boxes, points2d_px, confidence, points3d_m, covariance_m2 = nothing
        return People(boxes, points2d_px, confidence, points3d_m, covariance_m2)

    @staticmethod
    def shapes(n_joints: int) -> dict[str, tuple[int, ...]]:
        """Of each array, for one person."""
        return {
            "boxes": (5,),
            "points2d_px": (n_joints, 2),
            "confidence": (n_joints,),
            "points3d_m": (n_joints, 3),
            "covariance_m2": (n_joints, 3, 3),
        }


@runtime_checkable
class Tracker(Protocol):
    """Takes the images of one camera in order of time; may use what it saw before."""

    def detect(self, image: Image) -> People:
        """The people in the next image, the most confident first.

        Raises:
            ValueError: the image is not (height, width, 3) uint8.
        """
        ...


@runtime_checkable
class Network(Protocol):
    """A pose network. Its sessions may be used from several threads at once; what is remembered is in its trackers."""

    @property
    def name(self) -> str:
        """Model, file and settings: differs if results may differ. Part of the key of the cache."""
        ...

    @property
    def skeleton(self) -> Skeleton:
        """What its joints are."""
        ...

    def tracker(self, camera: Camera) -> Tracker:
        """For the images of one camera, whose size and intrinsics are those of the images."""
        ...


def people_in(image: Image, tracker: Tracker, network: Network) -> People:
    """What a tracker of a network finds in the next image, checked.

    Raises:
        ValueError: the network failed, which is the cause, or does not give People of its skeleton with confidences in
            [0, 1], but for rounding; the message names it.
    """
    try:
        found = tracker.detect(image)
    except Exception as error:
        raise ValueError(f"network {network.name} failed: {type(error).__name__}: {error}") from error
    _check(found, network)
    return found


def _check(found: object, network: Network) -> None:
    gave = f"network {network.name} gave"
    if not isinstance(found, People):
        raise ValueError(f"{gave} {type(found).__name__}, not fgpose.monocular.network.People")
    boxes = np.shape(found.boxes)
    if len(boxes) != 2 or boxes[1] != 5:
        raise ValueError(f"{gave} boxes {boxes}, not (people, 5)")
    n_people, n_joints = boxes[0], network.skeleton.n_joints
    for name, shape in People.shapes(n_joints).items():
        given, expected = np.shape(getattr(found, name)), (n_people, *shape)
        if given != expected:
            counted = f"{n_people} {'box' if n_people == 1 else 'boxes'}"
            raise ValueError(
                f"{gave} {name} {given} for {counted}, not {expected}: the joints of {network.skeleton.name}"
            )
    confidence = np.asarray(found.confidence, dtype=float)
    outside = (confidence < -_ROUNDING) | (confidence > 1 + _ROUNDING)
    if outside.any():
        raise ValueError(f"{gave} a confidence of {confidence[outside][0]:g}, not in [0, 1]")
