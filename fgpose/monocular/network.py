"""The one interface of all networks: an image goes in, people come out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, UInt8

from fgpose.geometry.camera import Camera
from fgpose.geometry.per_view.absolute_pose import AbsolutePose
from fgpose.observations import positive_definite
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
_LARGEST = 1e30  # cached in single precision


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
    """What a tracker of a network finds in the next image, checked, and copied: it may fill the same arrays again.

    Raises:
        ValueError: the network failed, which is the cause, or does not give People of its skeleton: numbers, with
            confidences in [0, 1], but for rounding, of all pixels that it gives; the message names it.
    """
    try:
        found = tracker.detect(image)
    except Exception as error:
        raise ValueError(f"network {network.name} failed: {type(error).__name__}: {error}") from error
    gave, skeleton = f"network {network.name} gave", network.skeleton
    if not isinstance(found, People):
        raise ValueError(f"{gave} {type(found).__name__}, not fgpose.monocular.network.People")
    if not all(isinstance(problem, str) for problem in found.problems):
        raise ValueError(f"{gave} problems that are no texts")
    arrays = {name: _copied(getattr(found, name), f"{gave} {name}") for name in People.shapes(skeleton.n_joints)}
    n_people = len(np.atleast_1d(arrays["boxes"]))
    for name, shape in People.shapes(skeleton.n_joints).items():
        if arrays[name].shape != (n_people, *shape):
            of_boxes = f" for {n_people} {'box' if n_people == 1 else 'boxes'}, not {(n_people, *shape)}"
            expected = ", not (people, 5)" if name == "boxes" else f"{of_boxes}: the joints of {skeleton.name}"
            raise ValueError(f"{gave} {name} {arrays[name].shape}{expected}")
    _check_values(arrays, gave)
    return replace(found, **arrays)  # pyrefly: ignore[bad-argument-type]


def _copied(values: object, what: str) -> np.ndarray:
    given = np.asarray(values)
    if given.dtype.kind not in "fiu":
        raise ValueError(f"{what} of {given.dtype}, not of numbers")
    copied = given.astype(np.result_type(given, np.float32))
    if (np.abs(copied) > _LARGEST).any():
        raise ValueError(f"{what} with {copied[np.abs(copied) > _LARGEST][0]:g}")
    return copied


def _check_values(arrays: Mapping[str, np.ndarray], gave: str) -> None:
    confidence, has_pixel = arrays["confidence"], np.isfinite(arrays["points2d_px"]).all(axis=-1)
    outside = (confidence < -_ROUNDING) | (confidence > 1 + _ROUNDING) | (np.isnan(confidence) & has_pixel)
    if outside.any():
        raise ValueError(f"{gave} a confidence of {confidence[outside][0]:g}, not in [0, 1]")
    covariance_m2 = arrays["covariance_m2"].astype(float)
    known = np.isfinite(arrays["points3d_m"]).all(axis=-1) & np.isfinite(covariance_m2).all(axis=(-2, -1))
    if (known & ~positive_definite(covariance_m2)).any():
        raise ValueError(f"{gave} a covariance_m2 that is not positive definite")
