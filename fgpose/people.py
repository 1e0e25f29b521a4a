"""What the cameras saw of several people: everybody in each image, in any order, at the time of that image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from fgpose.skeleton import Skeleton


@dataclass(frozen=True, eq=False)
class Detections:
    """Everybody whom one camera detected in one image; nobody is an image of its own (P = 0), not a missing one.

    A joint that was not detected is NaN with confidence 0, always both.

    Raises:
        ValueError: shapes disagree, a number is infinite, a confidence lies outside [0, 1] or the time is not finite.
            The message names the camera, the time, the person and the joint.
    """

    camera: str
    time_s: float
    points2d_px: np.ndarray
    """(P, J, 2) pixels of the original, distorted image."""
    confidence: np.ndarray
    """(P, J) in [0, 1]."""
    points3d_m: np.ndarray | None = None
    """(P, J, 3) absolute 3D joints as this view alone gives them, in the world frame, metres."""
    covariance3d_m2: np.ndarray | None = None
    """(P, J, 3, 3) of points3d_m, in the world frame."""
    appearance: np.ndarray | None = None
    """(P, F) what people look like, as a network for re-identification gives it: vectors of length 1, NaN = unknown."""

    def __post_init__(self) -> None:
        if not np.isfinite(self.time_s):
            raise ValueError(f"camera {self.camera}: the time of an image is not finite: {self.time_s}")
        points2d_px, confidence = np.array(self.points2d_px, dtype=float), np.array(self.confidence, dtype=float)
        if points2d_px.ndim != 3 or points2d_px.shape[2] != 2:
            raise ValueError(f"{self}: points2d_px must be (people, joints, 2), got {points2d_px.shape}")
        people_joints = points2d_px.shape[:2]
        shapes = {
            "confidence": people_joints,
            "points3d_m": (*people_joints, 3),
            "covariance3d_m2": (*people_joints, 3, 3),
            "appearance": (people_joints[0], None),
        }
        for name, shape in shapes.items():
            self._check_shape(name, shape)
        known = np.isfinite(points2d_px).all(axis=-1) & (confidence != 0)
        self._refuse(np.asarray(np.isinf(points2d_px).any(axis=-1)), "a pixel that is infinite")
        self._refuse(known & ~((confidence >= 0) & (confidence <= 1)), "a confidence outside [0, 1]")
        points2d_px[~known], confidence[~known] = np.nan, 0.0
        for name, array in (("points2d_px", points2d_px), ("confidence", confidence)):
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    def _check_shape(self, name: str, shape: tuple[int | None, ...]) -> None:
        array = getattr(self, name)
        if array is None:
            return
        got = np.shape(array)
        if len(got) != len(shape) or any(want not in (None, have) for want, have in zip(shape, got, strict=True)):
            raise ValueError(f"{self}: {name} must be {shape}, got {got}")

    def _refuse(self, bad: np.ndarray, what: str) -> None:
        if bad.any():
            person, joint = np.argwhere(bad)[0]
            raise ValueError(f"{self}, person {person}, joint number {joint}: {what}")

    def __str__(self) -> str:
        return f"camera {self.camera}, image at {self.time_s:g} s"

    @property
    def n_people(self) -> int:
        return len(self.points2d_px)


@dataclass(frozen=True, eq=False)
class PeopleObservations:
    """A recording of any number of people: the images of all cameras, each at its own time.

    Raises:
        ValueError: there is no image, an image is of a camera or of a number of joints that is not the recording's, or
            a camera has two images at one time.
    """

    skeleton: Skeleton
    camera_names: tuple[str, ...]
    images: tuple[Detections, ...] = field(repr=False)
    """In the order of time; of one time in the order of the cameras."""

    def __post_init__(self) -> None:
        number = {name: c for c, name in enumerate(self.camera_names)}
        if len(number) != len(self.camera_names):
            raise ValueError(f"camera names must differ, got {', '.join(self.camera_names)}")
        if not self.images:
            raise ValueError("a recording needs at least one image")
        for image in self.images:
            if image.camera not in number:
                raise ValueError(f"{image}: the recording has no such camera, only {', '.join(self.camera_names)}")
            if image.points2d_px.shape[1] != self.skeleton.n_joints:
                raise ValueError(
                    f"{image}: {image.points2d_px.shape[1]} joints, skeleton {self.skeleton.name} has "
                    f"{self.skeleton.n_joints}"
                )
        ordered = sorted(self.images, key=lambda image: (image.time_s, number[image.camera]))
        object.__setattr__(self, "images", tuple(ordered))
        before: dict[str, float] = {}
        for image in ordered:
            if before.get(image.camera) == image.time_s:
                raise ValueError(f"{image}: the camera has two images at this time")
            before[image.camera] = image.time_s

    @staticmethod
    def of_frames(
        skeleton: Skeleton,
        camera_names: Sequence[str],
        time_s: Float[np.ndarray, " frame"] | Float[np.ndarray, "frame camera"],
        points2d_px: Float[np.ndarray, "frame camera person joint 2"],
        confidence: Float[np.ndarray, "frame camera person joint"],
        points3d_m: Float[np.ndarray, "frame camera person joint 3"] | None = None,
        covariance3d_m2: Float[np.ndarray, "frame camera person joint 3 3"] | None = None,
    ) -> PeopleObservations:
        """From arrays with room for the same number of people in every image; who has no joint is not there.

        Args:
            time_s: of every frame, or of every image; NaN: no image.
        """
        time_s = np.array(time_s, dtype=float)
        time_s = time_s if time_s.ndim == 2 else np.repeat(time_s[:, None], len(camera_names), axis=1)
        is_there = np.asarray(np.isfinite(points2d_px).all(axis=-1).any(axis=-1))
        images = []
        for t, c in np.argwhere(np.isfinite(time_s)).tolist():
            here = is_there[t, c]
            in_3d = (None if array is None else array[t, c][here] for array in (points3d_m, covariance3d_m2))
            of_image = points2d_px[t, c][here], confidence[t, c][here], *in_3d
            images.append(Detections(camera_names[c], float(time_s[t, c]), *of_image))
        return PeopleObservations(skeleton, tuple(camera_names), tuple(images))

    @property
    def n_cameras(self) -> int:
        return len(self.camera_names)

    def times_s(self, camera: str) -> Float[np.ndarray, " image"]:
        """Of each image of a camera, increasing."""
        return np.array([image.time_s for image in self.images if image.camera == camera])
