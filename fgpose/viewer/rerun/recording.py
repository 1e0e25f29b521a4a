"""A recording in Rerun: results of one person, or people."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import rerun.blueprint as rrb
from jaxtyping import Float, UInt8

from fgpose.association.recording import Association
from fgpose.association.track import Tracked, TrackEvent
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.up_axis import UpAxis, up_vector
from fgpose.observations import Observations
from fgpose.people_observations import Detections
from fgpose.sampling import parts_of
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Estimate, Trajectory
from fgpose.viewer.pictures import PictureOptions
from fgpose.viewer.recording import Recording
from fgpose.viewer.rerun import palette, paths
from fgpose.viewer.rerun.blueprint import blueprint, people_blueprint
from fgpose.viewer.rerun.frame_clock import FrameClock
from fgpose.viewer.rerun.people import (
    Presence,
    absent,
    association_rows,
    log_people_scene,
    log_person_styles,
    person_rows,
    presence_of_tracked,
    update_rows,
)
from fgpose.viewer.rerun.results import (
    ResultLook,
    log_residual_styles,
    log_scene,
    observation_rows,
    residual_rows,
    trajectory_rows,
)
from fgpose.viewer.rerun.rows import scalar_rows
from fgpose.viewer.rerun.session import RerunSession, Target

_EARLIER_THICKNESS = 0.5  # of all results but the last, which shall stand out
_LOWEST_NAME_M, _NAME_STEP_M = 0.15, 0.25


@dataclass(frozen=True, eq=False)
class _Last:
    """The last frame in which somebody has been shown."""

    frame: int
    status: np.ndarray
    """(J,) of their joints in it."""
    after: Trajectory
    """What is shown in the frame after it, if there is one: otherwise they would stay where they were."""


class RerunRecording(RerunSession, Recording):
    """See Recording and open_recording.

    Args:
        target: where it is shown.
        scene: the cameras, the joints, and the names of the results of one person; without any, people are shown.
        up: the world axis that points up.
        pictures: how large they may be.
        layout: that it opens with; by default one for results, or for people.
    """

    def __init__(
        self,
        target: Target,
        scene: tuple[CameraRig, Skeleton, tuple[str, ...]],
        up: UpAxis,
        pictures: PictureOptions,
        layout: rrb.Blueprint | None = None,
    ) -> None:
        rig, skeleton, self._results = scene
        self._up: UpAxis = up
        self._every, self._kept = target.every, slice(None, None, target.every)
        self._factors: tuple[str, ...] = ()
        self._last_status: dict[str, np.ndarray] = {}
        self._introduced: set[int] = set()
        self._clock = FrameClock()
        self._last: dict[int, _Last] = {}
        self._presence: dict[int, Presence] = {}
        self._events: list[TrackEvent] = []
        """Of updates that are not shown since the one that was."""
        self._update = -1
        """Frame of the newest update; -1: there was none."""
        following = target.port is not None
        if self._results:
            layout = layout or blueprint(rig, skeleton, self._results, up, following=following)
        super().__init__(target, rig, skeleton, layout or people_blueprint(rig, up, following=following), pictures)
        if self._results:
            log_scene(self._open_stream, rig, skeleton, self._results, up)
        else:
            log_people_scene(self._open_stream, rig, skeleton, up)

    def log_observations(
        self,
        observations: Observations,
        weights: Float[np.ndarray, "frame camera joint"] | None = None,
        undistorted_px: Float[np.ndarray, "frame camera joint 2"] | None = None,
        every: int = 1,
    ) -> None:
        self._check_observations(observations, weights)
        shown = observations.frames(kept := self._kept_of("the observations have", every))
        more = [None if each is None else each[kept] for each in (weights, undistorted_px)]
        for part in parts_of(shown.n_frames):
            of_part = (None if each is None else each[part] for each in more)
            rows = observation_rows(shown.frames(part), self._rig, *of_part)
            self._send(rows, shown.frame_time_s[part], self._every * part.start, self._every)

    def log_trajectory(self, name: str, trajectory: Trajectory, every: int = 1) -> None:
        self._check_trajectory(name, trajectory)
        shown, before = trajectory.frames(self._kept_of(f"trajectory {name} has", every)), None
        for part in parts_of(shown.n_frames):
            rows = trajectory_rows(name, shown.frames(part), self._rig, self._look(name), before)
            self._send(rows, shown.time_s[part], self._every * part.start, self._every)
            before = shown.status[part.stop - 1]

    def log_residuals(
        self,
        time_s: Float[np.ndarray, " frame"],
        residuals: Mapping[str, Float[np.ndarray, "frame joint"]],
        every: int = 1,
    ) -> None:
        self._check_residuals(len(time_s), residuals)
        if residuals:
            kept = self._kept_of("the residuals have", every)
            self._name_factors(tuple(residuals))
            for part in parts_of(len(time_s[kept])):
                shown = {factor: values[kept][part] for factor, values in residuals.items()}
                now = time_s[kept][part], self._every * part.start, self._every
                self._send(residual_rows(self._skeleton, shown), *now)

    def _kept_of(self, what_has: str, every: int) -> slice:
        """Of one frame in so many, those that are shown."""
        if self._every % every:
            raise ValueError(f"{what_has} one frame in {every}, the recording shows one in {self._every}")
        return slice(None, None, self._every // every)

    def log_update_times(self, time_s: Float[np.ndarray, " frame"], update_ms: Float[np.ndarray, " frame"]) -> None:
        self._send([scalar_rows(paths.UPDATE_MS, update_ms[self._kept])], time_s[self._kept], step=self._every)

    def log_estimate(
        self,
        estimate: Estimate,
        observations: Observations | None = None,
        weights: Float[np.ndarray, "camera joint"] | None = None,
        *,
        update_ms: float | None = None,
        residuals: Mapping[str, Float[np.ndarray, " joint"]] | None = None,
    ) -> None:
        for smoothed in estimate.newly_smoothed if "smoothed" in self._results else ():
            self._log_frame("smoothed", smoothed)
        if estimate.frame % self._every:
            return
        now = np.array([estimate.time_s]), estimate.frame
        if observations is not None:
            of_frame = None if weights is None else weights[None]
            self._check_observations(observations, of_frame)
            self._send(observation_rows(observations, self._rig, of_frame), *now)
        if update_ms is not None:
            self._send([scalar_rows(paths.UPDATE_MS, np.array([update_ms]))], *now)
        if residuals:
            by_factor = {factor: np.asarray(values)[None] for factor, values in residuals.items()}
            self._check_residuals(1, by_factor)
            self._name_factors(tuple(residuals))
            self._send(residual_rows(self._skeleton, by_factor), *now)
        self._log_frame("online", estimate)
        self._updated(estimate.frame)

    def _log_frame(self, name: str, estimate: Estimate) -> None:
        trajectory = Trajectory.from_estimates([estimate], self._rig.names)
        self._check_trajectory(name, trajectory)
        if estimate.frame % self._every:
            return
        before = self._last_status.get(name)
        rows = trajectory_rows(name, trajectory, self._rig, self._look(name), before)
        self._send(rows, trajectory.time_s, estimate.frame)
        self._last_status[name] = trajectory.status[0]

    def _look(self, name: str) -> ResultLook:
        """The last one stands out, names stand above each other."""
        index, n_results = self._results.index(name), len(self._results)
        over_m = (_LOWEST_NAME_M + _NAME_STEP_M * (n_results - 1 - index)) * up_vector(self._up)
        thickness = 1.0 if name == self._results[-1] else _EARLIER_THICKNESS
        return ResultLook(palette.trajectory_colour(name, index), thickness, over_m if n_results > 1 else None)

    def _name_factors(self, factors: tuple[str, ...]) -> None:
        if factors != self._factors:
            log_residual_styles(self._open_stream, self._rig, self._skeleton, factors)
            self._factors = factors

    def log_association(self, association: Association) -> None:
        self._check_people()
        self._check_skeleton("the association", association.observations.skeleton)
        cameras = self._rig.subset(association.rig.names)
        self._introduce(association.people)
        time_s = association.frames.frame_time_s
        self._send(association_rows(association, cameras, self._every), time_s[self._kept], step=self._every)
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
        self._events += events
        if frame % self._every:
            return
        time_s = float(np.mean([image.time_s for image in images]))
        emptied = self._rig.names if len(images) > 1 else ()
        self._show_update(frame, time_s, images, people, self._events, emptied)
        self._events = []

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
        self._updated(frame)

    def _updated(self, frame: int) -> None:
        self._update = frame
        self._clock.forget(frame)

    def log_image(self, camera: str, frame: int, time_s: float, image: UInt8[np.ndarray, "height width 3"]) -> None:
        super().log_image(camera, frame, time_s, image)
        # Live, the next update says who is still there.
        if self._update < 0:
            self._pass(frame, np.array([time_s]))

    def _show(self, people: Mapping[int, Trajectory], first_frame: int, time_s: Float[np.ndarray, " frame"]) -> None:
        """The motion of people, all in the same frames."""
        before = {person: last for person, last in self._last.items() if 0 < first_frame - last.frame <= self._every}
        going_on = {person: last for person, last in before.items() if person in people}
        for person in going_on:
            del self._last[person]
        self._pass(first_frame, time_s)
        self._introduce(people)
        skipped = -first_frame % self._every
        kept = slice(skipped, None, self._every)
        for person, trajectory in people.items():
            shown, status = trajectory.frames(kept), going_on[person].status if person in going_on else None
            for part in parts_of(shown.n_frames):
                rows = person_rows(person, shown.frames(part), self._rig, up_vector(self._up), status)
                self._send(rows, time_s[kept][part], first_frame + skipped + self._every * part.start, self._every)
                status = shown.status[part.stop - 1]
            last_frame = first_frame + trajectory.n_frames - 1
            self._last[person] = _Last(last_frame, trajectory.status[-1].copy(), absent(trajectory))
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
            # The next one that is shown, if there is one.
            frame = min(last.frame + self._every - last.frame % self._every, self._clock.last_frame)
            rows = person_rows(person, last.after, self._rig, up_vector(self._up), last.status)
            self._send(rows, np.array([self._clock.time_s(frame)]), frame)
            del self._last[person]
            self._introduced.discard(person)

    def _one_frame(self, tracked: Tracked, frame: int, time_s: float) -> Trajectory:
        estimate = replace(tracked.estimate, frame=frame, time_s=time_s)
        trajectory = Trajectory.from_estimates([estimate], self._rig.names)
        self._check_person(tracked.person, trajectory, frame)
        return trajectory

    def _check_people(self) -> None:
        if self._results:
            raise ValueError(f"the recording was opened for {', '.join(self._results)} of one person, not for people")

    def _check_images(self, frame: int, images: Sequence[Detections]) -> None:
        self._check_people()
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
        self._check_people()
        if person < 0 or first_frame < 0:
            raise ValueError(f"people and frames are counted from 0, got person {person} from frame {first_frame} on")
        if trajectory.n_frames == 0:
            raise ValueError(f"the trajectory of person {person} has no frame")
        self._check_skeleton(f"the trajectory of person {person}", trajectory.skeleton)
        if trajectory.residual_px is not None:
            self._rig.subset(trajectory.camera_names)

    def _check_observations(self, observations: Observations, weights: np.ndarray | None) -> None:
        self._check_skeleton("the observations", observations.skeleton)
        observations.check_cameras(self._rig.names)
        if weights is not None and weights.shape != observations.seen.shape:
            raise ValueError(f"weights must be {observations.seen.shape} as the points are, got {weights.shape}")

    def _check_trajectory(self, name: str, trajectory: Trajectory) -> None:
        if name not in self._results:
            raise ValueError(f"the recording was opened for {', '.join(self._results) or 'people'}, not for {name!r}")
        self._check_skeleton(f"trajectory {name}", trajectory.skeleton)
        if trajectory.residual_px is not None and trajectory.residual_px.shape[1] != self._rig.n_cameras:
            raise ValueError(
                f"trajectory {name} has residuals in {trajectory.residual_px.shape[1]} cameras, "
                f"the recording has {self._rig.n_cameras}"
            )

    def _check_residuals(self, n_frames: int, residuals: Mapping[str, np.ndarray]) -> None:
        expected = (n_frames, self._skeleton.n_joints)
        for factor, values in residuals.items():
            if values.shape != expected:
                raise ValueError(f"residuals of {factor} must be {expected} (frames, joints), got {values.shape}")
