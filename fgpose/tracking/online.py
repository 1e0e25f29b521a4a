"""Everybody in the room, live: association, and an estimator for each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from fgpose.association.follow import Follower
from fgpose.association.track import TrackEvent
from fgpose.association.tracked import Tracked
from fgpose.config import Config
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from fgpose.people import Detections, refuse_mixed_appearance
from fgpose.skeleton import Skeleton
from fgpose.tracking.estimators import Newest, OneImage
from fgpose.tracking.parallel import ParallelEstimators

_MOST_EVENTS = 1000  # of hours, for those who never ask


class Tracker:
    """Everybody in the room, live: each update takes the newest images and returns the people at their time.

    An Estimator of each person who is confirmed gets the detections that are theirs. Time and memory grow with the
    people in the room, not with how long it runs. The estimators share tracking.max_processes processes, which end with
    the tracker: when it is closed, or left as a context.
    """

    def __init__(self, rig: CameraRig, skeleton: Skeleton, config: Config | None = None) -> None:
        self.rig, self.skeleton, self.config = rig, skeleton, config or Config()
        self._follower = Follower(rig, skeleton, self.config.tracking)
        self._estimators = ParallelEstimators(rig, skeleton, self.config)
        self._image_s: dict[str, float] = {}
        self._with_appearance: list[Detections] = []
        """The first image that has appearance vectors."""

    def __enter__(self) -> Tracker:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the other processes. Closing again does nothing."""
        self._estimators.close()

    def update(self, images: Sequence[Detections]) -> list[Tracked]:
        """Take the newest images: of all cameras or some, of one moment or one after another.

        Images of different cameras that are given together make one frame, each at its own time: one update of each
        estimator. An image that is given alone joins the frame of those before it, as Estimator.update_camera says,
        which costs an update of its own.

        Raises:
            ValueError: a camera is not in the rig, an image has another number of joints, is not later than the one
                before of its camera, or is older than the newest image by more than online.lag_s. The tracker is then
                as it was before.
            OSError: a process of estimators cannot be started again.

        Warns:
            UserWarning: a process of estimators ended; the estimates of its people begin anew.
        """
        self._check(images)
        people: list[Tracked] = []
        for moment in _moments(images):
            people = self._update(moment)
        del self._follower.events[:-_MOST_EVENTS]
        return people

    def events(self) -> list[TrackEvent]:
        """What has happened to tracks since this was last asked, in the order of time; the last 1,000 at most."""
        events, self._follower.events = self._follower.events, []
        return events

    def _check(self, images: Sequence[Detections]) -> None:
        newest = dict(self._image_s)
        for image in sorted(images, key=lambda image: image.time_s):
            if image.camera not in self.rig.names:
                raise ValueError(f"{image}: the rig has no such camera, only {', '.join(self.rig.names)}")
            if image.points2d_px.shape[1] != self.skeleton.n_joints:
                raise ValueError(
                    f"{image}: {image.points2d_px.shape[1]} joints, skeleton {self.skeleton.name} has "
                    f"{self.skeleton.n_joints}"
                )
            if image.time_s <= newest.get(image.camera, -np.inf):
                raise ValueError(f"{image}: not later than the camera's image before, {newest[image.camera]:g} s")
            if image.time_s < max(newest.values(), default=-np.inf) - self.config.online.lag_s:
                raise ValueError(f"{image}: older than the newest image by more than online.lag_s")
            newest[image.camera] = image.time_s
        with_appearance = [*self._with_appearance, *(image for image in images if image.appearance is not None)]
        refuse_mixed_appearance(with_appearance)
        self._image_s, self._with_appearance = newest, with_appearance[:1]

    def _update(self, images: list[Detections]) -> list[Tracked]:
        sightings = self._follower.see(images)
        in_images: dict[int, dict[str, tuple[np.ndarray, np.ndarray]]] = {}
        for sighting in sightings:
            for track, detection, joint in sighting.joints():
                in_images.setdefault(track, {})[sighting.image.camera] = detection, joint
        tracks = [track for track in self._follower.tracks if track.is_confirmed]
        shown = [(sighting.image, sighting.people()) for sighting in sightings]
        nothing = np.full((self.skeleton.n_joints, 2), np.nan), np.zeros(self.skeleton.n_joints)
        newest = {
            track.number: self._newest([(image, of_image.get(track.number, nothing)) for image, of_image in shown])
            for track in tracks
        }
        estimates = self._estimators.update(newest)
        return [
            Tracked(track.person, track.state, estimates[track.number], in_images.get(track.number, {}))
            for track in tracks
        ]

    def _newest(self, seen: list[tuple[Detections, tuple[np.ndarray, np.ndarray]]]) -> Newest:
        """What is new of one person: the images, and what each shows of the person, pixels and confidence."""
        if len(seen) == 1 and self.rig.n_cameras > 1:
            ((image, own),) = seen
            return OneImage(image.camera, image.time_s, *own)
        shape = (1, self.rig.n_cameras, self.skeleton.n_joints)
        points2d_px, confidence = np.full((*shape, 2), np.nan), np.zeros(shape)
        time_s = np.full((1, self.rig.n_cameras), np.nan)
        for image, own in seen:
            c = self.rig.names.index(image.camera)
            time_s[0, c], (points2d_px[0, c], confidence[0, c]) = image.time_s, own
        return Observations(self.skeleton, time_s, points2d_px, confidence, camera_names=self.rig.names)


def _moments(images: Sequence[Detections]) -> Iterator[list[Detections]]:
    """In the order of time, parted where a camera comes again."""
    moment: list[Detections] = []
    for image in sorted(images, key=lambda image: image.time_s):
        if any(image.camera == other.camera for other in moment):
            yield moment
            moment = []
        moment.append(image)
    if moment:
        yield moment
