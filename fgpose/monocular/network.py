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
        return People(
            np.zeros((0, 5)),
            np.zeros((0, n_joints, 2)),
            np.zeros((0, n_joints)),
            np.zeros((0, n_joints, 3)),
            np.zeros((0, n_joints, 3, 3)),
        )


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
