"""What the cameras saw of several people: everybody in each image, in any order, at the time of that image."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from fgpose.correspondences import NO_IMAGE, NOBODY, MatchedFrames, Seen, match_frames
from fgpose.frozen import changed
from fgpose.observations import (
    Observations,
    blanked,
    check_cameras,
    check_confidence,
    is_infinite,
    positive_definite,
    refuse_millimetres,
)
from fgpose.sampling import TimeRange, forward
from fgpose.shown import Shown
from fgpose.shown.unknown_names import check_names
from fgpose.skeleton import Skeleton
from fgpose.skeletons import named_skeleton

NOTHING = {"points2d_px": np.nan, "confidence": 0.0, "points3d_m": np.nan, "covariance3d_m2": np.nan}
"""The arrays of detections by name, and what they have for a joint that is not detected."""


@dataclass(frozen=True, eq=False, repr=False)
class Detections(Shown):
    """Everybody whom one camera detected in one image; nobody is an image of its own (P = 0), not a missing one.

    A joint that was not detected is NaN with confidence 0, always both.

    Raises:
        ValueError: shapes disagree, a number is infinite, a confidence lies outside [0, 1], the time is not finite or
            a covariance is not positive definite. The message names the camera, the time, the person and the joint.
    """

    camera: str
    time_s: float
    points2d_px: np.ndarray
    """(P, J, 2) pixels of the original, distorted image."""
    confidence: np.ndarray
    """(P, J) in [0, 1]."""
    points3d_m: np.ndarray | None = None
    """(P, J, 3) absolute 3D joints as this view alone gives them, in the world frame, metres; NaN: unknown. Their
    distances from the camera help to tell people apart, and a camera that has them may find somebody alone."""
    covariance3d_m2: np.ndarray | None = None
    """(P, J, 3, 3) of points3d_m, in the world frame. Without it, distances are taken to err by 4.3 %."""
    appearance: np.ndarray | None = None
    """(P, D) what a network for re-identification says of how each person looks, of any length; NaN where unknown.
    People who were away are recognised by it too. The vectors of a recording are compared by their directions."""
    arrived_s: float | None = field(default=None, init=False)
    """When the image came to this computer, by any clock of it that goes on; None: not known, see arriving. It tells a
    camera whose clock was set from one whose images had to wait."""

    def __post_init__(self) -> None:
        self._check_time(self.time_s)
        points2d_px, confidence = np.array(self.points2d_px, dtype=float), np.array(self.confidence, dtype=float)
        if points2d_px.ndim != 3 or points2d_px.shape[2] != 2:
            raise ValueError(f"{self}: points2d_px must be (people, joints, 2), got {points2d_px.shape}")
        people_joints = points2d_px.shape[:2]
        shapes = {
            "confidence": people_joints,
            "points3d_m": (*people_joints, 3),
            "covariance3d_m2": (*people_joints, 3, 3),
        }
        for name, shape in shapes.items():
            array = getattr(self, name)
            if array is not None and np.shape(array) != shape:
                raise ValueError(f"{self}: {name} must be {shape}, got {np.shape(array)}")
        if self.appearance is not None and (np.ndim(self.appearance) != 2 or len(self.appearance) != people_joints[0]):
            raise ValueError(f"{self}: appearance must be ({people_joints[0]}, any), got {np.shape(self.appearance)}")
        known = np.isfinite(points2d_px).all(axis=-1) & (confidence != 0)
        self._refuse(is_infinite(points2d_px), "a pixel that is infinite")
        if self.points3d_m is not None:
            self._refuse(is_infinite(np.asarray(self.points3d_m)), "a 3D coordinate that is infinite")
            if self.covariance3d_m2 is not None:
                in_3d = np.asarray(np.isfinite(self.points3d_m).all(axis=-1))
                wrong = in_3d & ~positive_definite(np.asarray(self.covariance3d_m2))
                self._refuse(wrong, "a covariance that is not positive definite")
        self._refuse(known & ~((confidence >= 0) & (confidence <= 1)), "a confidence outside [0, 1]")
        unknown = ~known
        points2d_px[unknown], confidence[unknown] = np.nan, 0.0
        for name, array in (("points2d_px", points2d_px), ("confidence", confidence)):
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    def _check_time(self, time_s: float) -> None:
        if not np.isfinite(time_s):
            raise ValueError(f"camera {self.camera}: the time of an image is not finite: {time_s}")

    def _refuse(self, bad: np.ndarray, what: str) -> None:
        if bad.any():
            person, joint, *_ = np.argwhere(bad)[0]
            raise ValueError(f"{self}, person {person}, joint number {joint}: {what}")

    def __str__(self) -> str:
        return f"camera {self.camera}, image at {self.time_s:.13g} s"

    def at(self, time_s: float) -> Detections:
        """The same in an image of another time. Raises ValueError if that is not finite."""
        self._check_time(time_s)
        return changed(self, time_s=time_s)

    def arriving(self, arrived_s: float) -> Detections:
        """The same, of which it is known when it came to this computer."""
        return changed(self, arrived_s=arrived_s)

    @property
    def n_people(self) -> int:
        return len(self.points2d_px)

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """Those that there are, by name."""
        given = {name: getattr(self, name) for name in NOTHING}
        return {name: array for name, array in given.items() if array is not None}

    def confident(self, least: float) -> Detections:
        """Without the joints of less confidence, and without the people of whom nothing is left."""
        too_low = (self.confidence < least) & (self.confidence > 0)
        if not too_low.any():
            return self
        left = (self.confidence >= least).any(axis=1)
        arrays = {name: blanked(array, too_low)[left] for name, array in self.arrays.items()}
        return replace(self, **arrays, appearance=None if self.appearance is None else self.appearance[left])

    def of_person(
        self, detection: Int[np.ndarray, " joint"], joint: Int[np.ndarray, " joint"]
    ) -> dict[str, np.ndarray]:
        """The arrays of somebody whose joints are these of these detections; NOTHING where the detection is NOBODY."""
        known, shown = detection != NOBODY, {}
        for name, array in self.arrays.items():
            shown[name] = np.full(array.shape[1:], NOTHING[name])
            shown[name][known] = array[detection[known], joint[known]]
        return shown


@dataclass(frozen=True, eq=False, repr=False)
class PeopleObservations(Shown):
    """A recording of any number of people: the images of all cameras, each at its own time.

    Raises:
        ValueError: there is no image, an image is of a camera or of a number of joints that is not the recording's, a
            camera has two images at one time, or a length is implausible (millimetres where metres are meant).
    """

    skeleton: Skeleton
    """When it is made, also the name of one that comes with fgpose."""
    camera_names: tuple[str, ...]
    images: tuple[Detections, ...] = field(repr=False)
    """In the order of time; of one time in the order of the cameras."""
    given_frames: MatchedFrames | None = field(default=None, repr=False)
    """Which images belong together, where their source says it; see frames."""
    remarks: tuple[str, ...] = field(default=(), repr=False)
    """What was changed or left out when they were read."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "skeleton", named_skeleton(self.skeleton))
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
        refuse_mixed_appearance(ordered)
        in_3d = [image.points3d_m for image in ordered if image.points3d_m is not None]
        if in_3d:
            refuse_millimetres(np.concatenate(in_3d))

    @cached_property
    def frames(self) -> MatchedFrames:
        """Which images belong together: as given, else those of about the same time (see match_frames)."""
        return self.given_frames or match_frames([self.times_s(name) for name in self.camera_names])

    @property
    def n_frames(self) -> int:
        return len(self.frames.image)

    @property
    def frame_time_s(self) -> Float[np.ndarray, " frame"]:
        """One time per frame: the mean over the cameras where they differ."""
        return self.frames.frame_time_s

    @staticmethod
    def of_frames(
        skeleton: Skeleton | str,
        camera_names: Sequence[str],
        time_s: Float[np.ndarray, " frame"] | Float[np.ndarray, "frame camera"],
        points2d_px: Float[np.ndarray, "frame camera person joint 2"],
        confidence: Float[np.ndarray, "frame camera person joint"],
        points3d_m: Float[np.ndarray, "frame camera person joint 3"] | None = None,
        covariance3d_m2: Float[np.ndarray, "frame camera person joint 3 3"] | None = None,
    ) -> PeopleObservations:
        """From arrays with room for the same number of people in every image; who has no joint is not there.

        Args:
            skeleton: what the joints are; also the name of one that comes with fgpose.
            time_s: of every frame, or of every image; NaN: no image.
        """
        frame_time_s = np.array(time_s, dtype=float)
        time_s = frame_time_s if frame_time_s.ndim == 2 else np.repeat(frame_time_s[:, None], len(camera_names), axis=1)
        is_there = np.asarray(np.isfinite(points2d_px).all(axis=-1).any(axis=-1))
        images = []
        for t, c in np.argwhere(np.isfinite(time_s)).tolist():
            here = is_there[t, c]
            in_3d = (None if array is None else array[t, c][here] for array in (points3d_m, covariance3d_m2))
            of_image = points2d_px[t, c][here], confidence[t, c][here], *in_3d
            images.append(Detections(camera_names[c], float(time_s[t, c]), *of_image))
        image = np.where(np.isfinite(time_s), np.cumsum(np.isfinite(time_s), axis=0) - 1, NO_IMAGE)
        frames = MatchedFrames(frame_time_s, image)
        return PeopleObservations(named_skeleton(skeleton), tuple(camera_names), tuple(images), frames)

    @staticmethod
    def of_one(observations: Observations) -> PeopleObservations:
        """Of one person. A camera without an image, and one that shows nobody, are the same there: each has its image
        in every frame that it has a time for."""
        arrays = observations.per_detection(lambda array: array[:, :, None])
        people = PeopleObservations.of_frames(
            observations.skeleton, observations.camera_names, observations.time_s, **arrays
        )
        return replace(people, remarks=observations.remarks)

    def image(self, frame: int, camera: int) -> Detections:
        """That of a camera, by its number, in a frame; there must be one."""
        return self.by_camera[self.camera_names[camera]][self.frames.image[frame, camera]]

    def __iter__(self) -> Iterator[list[Detections]]:
        """Frame by frame, each its images, as Tracker.update takes them."""
        by_camera = [self.by_camera[name] for name in self.camera_names]
        for of_frame in self.frames.image.tolist():
            yield [images[i] for images, i in zip(by_camera, of_frame, strict=True) if i != NO_IMAGE]

    @property
    def n_most(self) -> int:
        """People in the image that shows most."""
        return max(image.n_people for image in self.images)

    @cached_property
    def n_showing(self) -> Int[np.ndarray, " frame"]:
        """How many cameras show somebody, in each frame."""
        shows = np.zeros(self.frames.image.shape, dtype=bool)
        for c, name in enumerate(self.camera_names):
            n_people = np.array([image.n_people for image in self.by_camera[name]] + [0], dtype=int)
            shows[:, c] = n_people[np.where(self.frames.image[:, c] == NO_IMAGE, -1, self.frames.image[:, c])] > 0
        return shows.sum(axis=1)

    def only(self, number: int = 0) -> Seen:
        """One detection of every image: where no image shows more than one, that person.

        Args:
            number: of the detection; an image that has fewer shows nobody.
        """
        frames = self.frames
        seen = Seen.nothing(len(frames.image), len(self.camera_names), self.skeleton.n_joints)
        seen.joint[:] = np.arange(self.skeleton.n_joints)
        for c, name in enumerate(self.camera_names):
            n_people = np.array([image.n_people for image in self.by_camera[name]], dtype=int)
            frame = np.flatnonzero(frames.image[:, c] != NO_IMAGE)
            seen.detection[frame[n_people[frames.image[frame, c]] > number], c] = number
        return seen

    def of_person(self, seen: Seen) -> Observations:
        """What the cameras saw of one person, in the frames of seen."""
        shapes = {name: array.shape[2:] for image in self.images for name, array in image.arrays.items()}
        arrays = {name: np.full((*seen.detection.shape, *shape), NOTHING[name]) for name, shape in shapes.items()}
        for t, c in np.argwhere((seen.detection != NOBODY).any(axis=-1)).tolist():
            image = self.image(seen.first_frame + t, c)
            for name, values in image.of_person(seen.detection[t, c], seen.joint[t, c]).items():
                arrays[name][t, c] = values
        time_s = self.frames.time_s[seen.frames]
        return Observations(self.skeleton, time_s, camera_names=self.camera_names, remarks=self.remarks, **arrays)

    def confident(self, least: float) -> PeopleObservations:
        """Without the detections of less confidence. Raises ValueError unless it lies in [0, 1]."""
        check_confidence(least)
        return replace(self, images=tuple(image.confident(least) for image in self.images)) if least > 0 else self

    def subset(self, camera_names: Sequence[str]) -> PeopleObservations:
        """The images of some of the cameras. Raises ValueError if there is none, or a name is unknown."""
        check_names(camera_names, self.camera_names, "the recording has no camera", "it has")
        images = tuple(image for image in self.images if image.camera in camera_names)
        kept = [self.camera_names.index(name) for name in camera_names]
        frames = None if self.given_frames is None else self.given_frames.subset(kept)
        return PeopleObservations(self.skeleton, tuple(camera_names), images, frames, self.remarks)

    def check_cameras(self, rig_names: tuple[str, ...]) -> None:
        """Raise ValueError unless the rig has exactly these cameras in this order."""
        check_cameras(self.camera_names, rig_names)

    def first_frames(self, n_frames: int) -> PeopleObservations:
        """The images of the first frames. Raises ValueError if there is none."""
        return self[:n_frames]

    def __getitem__(self, frames: slice) -> PeopleObservations:
        """Some of the frames with their images, as people[100:200]. Raises ValueError if no image is left, or the step
        is negative, TypeError for what is no slice."""
        if not isinstance(frames, slice):
            raise TypeError(f"frames are taken as a slice, as people[0:1]; got {frames!r:.40}")
        matched, used = self.frames.part(forward(frames))
        kept = [
            of_camera[n] for of_camera, own in zip(self.by_camera.values(), used, strict=True) for n in own.tolist()
        ]
        return replace(self, images=tuple(kept), given_frames=matched)

    def crop(self, begin_s: float, end_s: float) -> PeopleObservations:
        """The frames from one time to another, seconds, both included. Raises ValueError if there is none."""
        inside = np.flatnonzero(TimeRange(begin_s, end_s).of(self.frame_time_s))
        return self[inside[0] : inside[-1] + 1]

    @cached_property
    def by_camera(self) -> dict[str, list[Detections]]:
        """The images of each camera, in the order of time."""
        images: dict[str, list[Detections]] = {name: [] for name in self.camera_names}
        for image in self.images:
            images[image.camera].append(image)
        return images

    def times_s(self, camera: str) -> Float[np.ndarray, " image"]:
        """Of each image of a camera, increasing."""
        return np.array([image.time_s for image in self.by_camera[camera]])


def refuse_mixed_appearance(images: Iterable[Detections]) -> None:
    """Raise ValueError if images have appearance vectors of different lengths, which cannot be compared."""
    lengths = {image.appearance.shape[1]: image for image in images if image.appearance is not None}
    if len(lengths) > 1:
        (n, image), (m, other) = list(lengths.items())[:2]
        raise ValueError(f"{image}: appearance vectors of {n} numbers, but of {m} in {other}")
