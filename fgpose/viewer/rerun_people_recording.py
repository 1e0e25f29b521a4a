"""The recording of several people in Rerun."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from jaxtyping import Float, UInt8

from fgpose.association.recording import Association
from fgpose.association.track import TrackEvent
from fgpose.association.tracked import Tracked
from fgpose.geometry.camera import CameraRig
from fgpose.people import Detections
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Trajectory
from fgpose.viewer.clock import Clock
from fgpose.viewer.people_blueprint import people_blueprint
from fgpose.viewer.people_content import association_rows, nobody, person_rows, update_rows
from fgpose.viewer.people_scene import log_people_scene, log_person_styles
from fgpose.viewer.pictures import PictureOptions
from fgpose.viewer.presence import Presence, presence_of_tracked
from fgpose.viewer.recording import Recording
from fgpose.viewer.rerun_session import RerunSession, Target
from fgpose.viewer.scene import up_vector
from fgpose.viewer.session import UpAxis


@dataclass(frozen=True, eq=False)
class _Last:
    """The last frame in which somebody has been shown."""

    frame: int
    status: np.ndarray
    """(J,) of their joints in it."""
    after: Trajectory
    """What is shown in the frame after it, if there is one: otherwise they would stay where they were."""


class RerunPeopleRecording(RerunSession, Recording):
    """See Recording and open_people_recording."""

    server_mb: ClassVar[float] = 1024.0  # 20,000 frames of 8 people in 8 cameras take half of it
    is_of_system: ClassVar[bool] = False
    """Whether cameras and delays are shown too."""

    def __init__(
        self, target: Target, rig: CameraRig, skeleton: Skeleton, up: UpAxis, pictures: PictureOptions
    ) -> None:
        self._up = up_vector(up)
        self._introduced: set[int] = set()
        self._clock = Clock()
        self._last: dict[int, _Last] = {}
        self._presence: dict[int, Presence] = {}
        self._update = -1
        """Frame of the newest update; -1: there was none."""
        layout = people_blueprint(rig, up, following=target.port is not None, of_system=self.is_of_system)
        super().__init__(target, rig, skeleton, layout, pictures)
        log_people_scene(self._open_stream, rig, skeleton, up)

    def log_association(self, association: Association) -> None:
        self._check_skeleton("the association", association.observations.skeleton)
        cameras = self._rig.subset(association.rig.names)
        self._introduce(association.people)
        time_s = association.frames.frame_time_s
        self._send(association_rows(association, cameras), time_s)
        self._pass(0, time_s)

    def log_person(self, person: int, trajectory: Trajectory, first_frame: int = 0) -> None:
        self._check_person(person, trajectory, first_frame)
        self._show({person: trajectory}, first_frame, trajectory.time_s)

    def log_tracked(
        self, frame: int, images: Sequence[Detections], people: Sequence[Tracked], events: Sequence[TrackEvent] = ()
    ) -> None:
        self._check_images(frame, images)
        if not images:
            return
        time_s = float(np.mean([image.time_s for image in images]))
        self._show_update(frame, time_s, images, people, events, self._rig.names if len(images) > 1 else ())

    def _show_update(
        self,
        frame: int,
        time_s: float,
        images: Sequence[Detections],
        people: Sequence[Tracked],
        events: Sequence[TrackEvent],
        emptied: Collection[str],
    ) -> None:
        trajectories = {each.person: self._one_frame(each, frame, time_s) for each in people}
        self._show(trajectories, frame, np.array([time_s]))
        rows = update_rows(images, people, events, self._rig, self._presence, emptied)
        self._send(rows, np.array([time_s]), frame)
        self._presence = {each.person: presence_of_tracked(each) for each in people}
        self._update = frame
        self._clock.forget(frame)

    def log_image(self, camera: str, frame: int, time_s: float, image: UInt8[np.ndarray, "height width 3"]) -> None:
        super().log_image(camera, frame, time_s, image)
        # Live, the next update says who is still there.
        if self._update < 0:
            self._pass(frame, np.array([time_s]))

    def _show(self, people: Mapping[int, Trajectory], first_frame: int, time_s: Float[np.ndarray, " frame"]) -> None:
        """The motion of people, all in the same frames."""
        before = {person: last for person, last in self._last.items() if last.frame + 1 == first_frame}
        going_on = {person: last for person, last in before.items() if person in people}
        for person in going_on:
            del self._last[person]
        self._pass(first_frame, time_s)
        self._introduce(people)
        for person, trajectory in people.items():
            status = going_on[person].status if person in going_on else None
            self._send(person_rows(person, trajectory, self._rig, self._up, status), time_s, first_frame)
            last_frame = first_frame + trajectory.n_frames - 1
            self._last[person] = _Last(last_frame, trajectory.status[-1].copy(), nobody(trajectory))
        self._end()

    def _introduce(self, people: Iterable[int]) -> None:
        new = set(people) - self._introduced
        self._introduced |= new
        for person in sorted(new):
            log_person_styles(self._open_stream, self._rig, self._skeleton, person)

    def _pass(self, first_frame: int, time_s: Float[np.ndarray, " frame"]) -> None:
        """These frames are part of the recording."""
        self._clock.learn(first_frame, time_s)
        self._end()

    def _end(self) -> None:
        """Whoever was shown last in a frame before the last one disappears."""
        over = {person: last for person, last in self._last.items() if last.frame < self._clock.last_frame}
        for person, last in over.items():
            frame = last.frame + 1
            rows = person_rows(person, last.after, self._rig, self._up, last.status)
            self._send(rows, np.array([self._clock.time_s(frame)]), frame)
            del self._last[person]
            self._introduced.discard(person)

    def _one_frame(self, tracked: Tracked, frame: int, time_s: float) -> Trajectory:
        estimate = replace(tracked.estimate, frame=frame, time_s=time_s)
        trajectory = Trajectory.from_estimates([estimate], self._rig.names)
        self._check_person(tracked.person, trajectory, frame)
        return trajectory

    def _check_images(self, frame: int, images: Sequence[Detections]) -> None:
        if frame <= self._update:
            raise ValueError(f"the next update is of frame {self._update + 1} or later, got frame {frame}")
        cameras = [image.camera for image in images]
        for image in images:
            self._rig.subset([image.camera])
            if cameras.count(image.camera) > 1:
                raise ValueError(f"{image}: the camera has several images in frame {frame}")
            if image.points2d_px.shape[1] != self._skeleton.n_joints:
                raise ValueError(
                    f"{image}: {image.points2d_px.shape[1]} joints, the recording was opened with "
                    f"{self._skeleton.name}, which has {self._skeleton.n_joints}"
                )

    def _check_person(self, person: int, trajectory: Trajectory, first_frame: int) -> None:
        if person < 0 or first_frame < 0:
            raise ValueError(f"people and frames are counted from 0, got person {person} from frame {first_frame} on")
        if trajectory.n_frames == 0:
            raise ValueError(f"the trajectory of person {person} has no frame")
        self._check_skeleton(f"the trajectory of person {person}", trajectory.skeleton)
        if trajectory.residual_px is not None:
            self._rig.subset(trajectory.camera_names)
