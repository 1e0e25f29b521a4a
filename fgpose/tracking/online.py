"""Everybody in the room, live: association, and an estimator for each."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence, Set

import numpy as np

from fgpose.association.follow import Follower
from fgpose.association.identity.appearance import Resemblance
from fgpose.association.track import Track, Tracked, TrackEvent
from fgpose.config import Config
from fgpose.estimation.evidence.inputs import check_known
from fgpose.estimation.online.clock_jumps import SET_BACK, SetBack
from fgpose.estimation.online.clock_offsets import RunningOffsets
from fgpose.estimation.online.clock_steps import ClockSteps
from fgpose.estimation.online.exclusive import Exclusive, exclusive
from fgpose.estimation.online.one_moment import OneMoment, taken_together
from fgpose.geometry.camera import CameraRig
from fgpose.io.live.tracker_memory import TrackerMemory
from fgpose.io.skeletons import as_skeleton
from fgpose.observations import refuse_millimetres
from fgpose.people_observations import NOTHING, Detections, refuse_mixed_appearance
from fgpose.sampling import Pace
from fgpose.shown import Shown
from fgpose.skeleton import Skeleton
from fgpose.tracking.estimator_process import ANSWERS_WITHIN_S
from fgpose.tracking.estimators import NewDetections
from fgpose.tracking.known_bones import KnownBones
from fgpose.tracking.memory import go_on, memory_of
from fgpose.tracking.moments import believed_of, moments_of, times_s
from fgpose.tracking.parallel import ParallelEstimators

_APPLY_OFFSETS_S = 0.5
_MOST_EVENTS = 1000  # of hours, for those who never ask


class Tracker(Shown, Exclusive):
    """Everybody in the room, live: each update takes the newest images and returns the people at their time.

    An Estimator of each person who is confirmed gets the detections that are theirs. Time and memory grow with the
    people in the room, not with how long it runs. The estimators share tracking.max_processes processes, which end with
    the tracker: when it is closed, or left as a context. With online.estimate_time_offsets the motion of all people
    together tells how late each camera is (offsets). Several threads may use it: one waits for the other. Copies and
    pickles need a single process and the window solver.

    Args:
        rig, skeleton: of the images; a skeleton may be given by its name.
        config: None: the default.
        answers_within_s: a process that does not is replaced, as one that has ended is, and one that is stopped at
            once. By default a minute: no busy machine takes so long.
        memory: of a tracker before, with the same rig, skeleton and config: whom it knew may be recognised.
    """

    def __init__(
        self,
        rig: CameraRig,
        skeleton: Skeleton | str,
        config: Config | None = None,
        *,
        answers_within_s: float = ANSWERS_WITHIN_S,
        memory: TrackerMemory | None = None,
    ) -> None:
        super().__init__()
        check_known("Tracker", rig, skeleton)
        skeleton = as_skeleton(skeleton)
        self.rig, self.skeleton, self.config = rig, skeleton, config or Config()
        self._follower = Follower(rig, skeleton, self.config.tracking)
        self._estimators = ParallelEstimators(rig, skeleton, self.config, answers_within_s)
        self._bones = KnownBones()
        self._people: list[Tracked] = []
        self._used: tuple[Detections, ...] = ()
        self._nobodys: dict[str, Detections] = {}
        self._waiting: list[Detections] = []
        """Images that are far later than all before."""
        self._image_s: dict[str, float] = {}
        self._set_back = SetBack()
        self._pace, self._one_moment = Pace(), OneMoment(rig.names)
        self._steps = ClockSteps(rig.names)
        self._told_of: set[str] = set()
        """Cameras whose images are not used, which was said."""
        self._has_covariance: bool | None = None
        """Whether per-view 3D comes with covariance; None: there was none yet."""
        self._with_appearance: list[Detections] = []
        """The first image that has appearance vectors."""
        self._offsets_applied_s = -np.inf
        if memory is not None:
            go_on(memory, self._follower, self._bones, self.offsets, skeleton)

    def __enter__(self) -> Tracker:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @exclusive
    def close(self) -> None:
        """End the other processes. Closing again does nothing."""
        self._estimators.close()

    def await_ready(self) -> None:
        """Wait until all processes have started, which is a second; otherwise the first update that needs them does.

        Raises:
            OSError: one does not start.
        """
        self._estimators.await_ready()

    @exclusive
    def update(self, images: Sequence[Detections]) -> list[Tracked]:
        """Take the newest images: of all cameras or some, of one moment or one after another.

        Images of different cameras that are given together make one frame, each at its own time: one update of each
        estimator. An image that is given alone joins the frame of those before it, as Estimator.update_camera says,
        which costs an update of its own. One that is more than a minute later than all before waits until another
        camera says so too in an update of its own, for images that are given together may share a wrong stamp. After
        ten updates with nothing but images that are more than a minute older the clock was set back: nobody is followed
        or recognised any more, and people get new numbers. Images of a camera whose clock was set, and most others were
        not, are left out until it is right again (ClockSteps); images that had to wait are not taken for such if they
        say when they arrived (Detections.arriving).

        Returns:
            Everybody at the time of the newest image that was used.

        Raises:
            ValueError: a camera is not in the rig, an image has another number of joints, is not later than the one
                before of its camera, or is older than the newest image by more than online.lag_s; per-view 3D looks
                like millimetres, or has a covariance in some images only. The tracker is then as it was before.
            OSError: a process of estimators cannot be started again.

        Warns:
            UserWarning: a process of estimators ended or did not answer; the estimates of its people begin anew. Images
                of a camera are left out, as they are far later than all others, or were taken far from those given with
                them (OneMoment), or its clock was set (ClockSteps); all clocks were set back; or times are not in
                seconds.
        """
        self._used = tuple(self._taken(images))
        if not images:
            self._people = []
        for moment in moments_of(self._used):
            self._people = self._update(moment)
        del self._follower.events[:-_MOST_EVENTS]
        return list(self._people)

    @property
    def nobodys(self) -> dict[str, Detections]:
        """By camera, of its newest image the detections that are of nobody whom the last update has given."""
        return dict(self._nobodys)

    @property
    def n_restarts(self) -> int:
        """How often a process of estimators was started again."""
        return self._estimators.n_restarts

    @property
    def offsets(self) -> RunningOffsets:
        """What is known of the cameras' clocks beyond the rig; its sigma_s may be set at any time."""
        return self._estimators.offsets

    @property
    def used(self) -> tuple[Detections, ...]:
        """Images that the last update has used; Tracked.seen says who is in them."""
        return self._used

    def leaves_out(self, image: Detections) -> bool:
        """Whether an image would be left out if it came next, as the clock of its camera was set (ClockSteps)."""
        return bool(self._steps.plus(*times_s([image], self.rig.names)).left_out[self.rig.names.index(image.camera)])

    @property
    def set_clocks(self) -> dict[str, str]:
        """By camera what is said of its clock, of which it is sure that it was set: its images are left out."""
        return {self.rig.names[c]: self._steps.in_words(c) for c in np.flatnonzero(self._steps.lasts).tolist()}

    @exclusive
    def memory(self) -> TrackerMemory | None:
        """For a tracker that goes on later, see save_memory; None before the first image."""
        known = self._follower, self._bones, self.offsets
        return memory_of(*known, max(self._image_s.values())) if self._image_s else None

    @exclusive
    def look(self) -> None:
        """Replace processes that have ended, as each update does: for where no image comes.

        Raises:
            OSError: one cannot be started again.

        Warns:
            UserWarning: one has ended, or is stopped where it must answer within a time.
        """
        self._estimators.look()

    @exclusive
    def tidy(self) -> None:
        """Let the estimators do what the next update would do first, see Estimator.tidy."""
        self._estimators.tidy()

    @exclusive
    def events(self) -> list[TrackEvent]:
        """What has happened to tracks since this was last asked, in the order of time; the last 1,000 at most."""
        events, self._follower.events = self._follower.events, []
        return events

    def _taken(self, images: Sequence[Detections]) -> list[Detections]:
        """Those of the images, and of those before, that are to be used now. Raises ValueError as update."""
        newest, has_covariance = dict(self._image_s), self._has_covariance
        for image in images:
            if image.camera not in self.rig.names:
                raise ValueError(f"{image}: the rig has no such camera, only {', '.join(self.rig.names)}")
            if image.points2d_px.shape[1] != self.skeleton.n_joints:
                raise ValueError(
                    f"{image}: {image.points2d_px.shape[1]} joints, skeleton {self.skeleton.name} has "
                    f"{self.skeleton.n_joints}"
                )
        given, waiting = [*self._waiting, *images], self._waiting
        newest_s, last_s = (
            max(newest.values(), default=-np.inf),
            max((image.time_s for image in images), default=np.inf),
        )
        if is_set_back := self._set_back.is_seen(last_s, newest_s):
            newest, waiting = {}, []
        believed, waiting = believed_of(images, waiting, newest, self.rig.n_cameras)
        images, steps = self._of_their_time(believed, ClockSteps(self.rig.names) if is_set_back else self._steps)
        for image in sorted(images, key=lambda image: image.time_s):
            if image.time_s <= newest.get(image.camera, -np.inf):
                raise ValueError(f"{image}: not later than the camera's image before, {newest[image.camera]:.13g} s")
            ahead = max(newest, key=newest.__getitem__, default=image.camera)
            if image.time_s < newest.get(ahead, -np.inf) - self.config.online.lag_s:
                raise ValueError(
                    f"{image}: older than the newest image, of {ahead} at {newest[ahead]:.13g} s, by more than "
                    "online.lag_s; is the clock of one of them another one?"
                )
            newest[image.camera] = image.time_s
            if image.points3d_m is not None:
                try:
                    refuse_millimetres(image.points3d_m)
                except ValueError as error:
                    raise ValueError(f"{image}: {error}") from None
                if has_covariance not in (None, image.covariance3d_m2 is not None):
                    raise ValueError(f"{image}: give a covariance3d_m2 with all points3d_m or with none")
                has_covariance = image.covariance3d_m2 is not None
        with_appearance = [*self._with_appearance, *(image for image in images if image.appearance is not None)]
        refuse_mixed_appearance(with_appearance)
        if is_set_back:
            self._begin_anew(last_s, newest_s - last_s)
        for camera, time_s in newest.items():
            if time_s > self._image_s.get(camera, np.inf):
                self._pace.add(time_s - self._image_s[camera])
        self._image_s, self._with_appearance = newest, with_appearance[:1]
        self._has_covariance, self._waiting, self._steps = has_covariance, waiting, steps
        self.offsets.set_by_s = steps.lasting_s
        steps.warn()
        self._warn_of_unused(given, {image.camera for image in (*believed, *waiting)})
        return images

    def _begin_anew(self, time_s: float, by_s: float) -> None:
        """At this time of a clock that was set back."""
        warnings.warn(SET_BACK.format(by_s=by_s), UserWarning, stacklevel=5)
        self._estimators.update({})
        before, self._follower = self._follower, Follower(self._follower.rig, self.skeleton, self.config.tracking)
        self._follower.go_on(before.n_people, {}, Resemblance())
        people = sorted(track.person for track in before.tracks if track.is_confirmed)
        ended = (TrackEvent(time_s, person, "lost", "the clock was set back") for person in people)
        self._follower.events = [*before.events, *ended]
        self._bones, self._set_back, self._image_s, self._nobodys = KnownBones(), SetBack(), {}, {}
        self._offsets_applied_s = -np.inf

    def _of_their_time(self, believed: Sequence[Detections], steps: ClockSteps) -> tuple[list[Detections], ClockSteps]:
        """Without those that were taken far from the others given with them, and those of cameras whose clocks were
        set."""
        images, names = list[Detections](), self.rig.names
        for moment in moments_of(believed):
            together = self._taken_together(moment)
            steps = steps.plus(*times_s(together, names))
            left_out = np.array(names)[steps.left_out]
            images += [image for image in together if image.camera not in left_out]
        return images, steps

    def _taken_together(self, images: list[Detections]) -> list[Detections]:
        """Without those that were taken far from the others."""
        taken_s = np.array([image.time_s for image in images])
        together = taken_together(taken_s, self._pace.usual_step_s)
        usual_s = float(taken_s[together].mean())
        self._one_moment.warn({images[i].camera: images[i].time_s - usual_s for i in np.flatnonzero(~together)})
        return [images[i] for i in np.flatnonzero(together)]

    def _warn_of_unused(self, given: Sequence[Detections], believed: Set[str]) -> None:
        """Once for each camera."""
        for image in given:
            if image.camera not in believed | self._told_of:
                self._told_of.add(image.camera)
                warnings.warn(
                    f"{image}: more than a minute later than those of all others, and not used. Is the clock of "
                    f"{image.camera} another one?",
                    UserWarning,
                    stacklevel=5,
                )

    def _update(self, images: list[Detections]) -> list[Tracked]:
        sightings = self._follower.see(images)
        seen: dict[int, dict[str, tuple[np.ndarray, np.ndarray]]] = {}
        for sighting in sightings:
            for track, detection, joint in sighting.joints():
                seen.setdefault(track, {})[sighting.image.camera] = detection, joint
        tracks = [track for track in self._follower.tracks if track.is_confirmed]
        numbers = [track.number for track in tracks]
        self._nobodys |= {sighting.image.camera: sighting.of_others(numbers) for sighting in sightings}
        self._apply_offsets(images[-1].time_s)
        newest = {track.number: self._newest(images, track, seen.get(track.number, {})) for track in tracks}
        estimates = self._estimators.update(newest)
        bones = {track.person: estimates[track.number].bone_lengths for track in tracks}
        self._bones.learn(bones, newest, self._follower.lost)
        return [
            Tracked(
                track.person,
                track.state,
                estimates[track.number],
                seen.get(track.number, {}),
                is_provisional=self._follower.is_provisional(track, images[-1].time_s),
                former=track.former,
            )
            for track in tracks
        ]

    def _apply_offsets(self, time_s: float) -> None:
        """The association uses those that the estimators have learned; they change slowly."""
        if self.offsets.has_told and time_s >= self._offsets_applied_s + _APPLY_OFFSETS_S:
            self._follower.rig, self._offsets_applied_s = self.offsets.rig(), time_s

    def _newest(
        self, images: Sequence[Detections], track: Track, seen: Mapping[str, tuple[np.ndarray, np.ndarray]]
    ) -> NewDetections:
        """What is new of one person: the images, and which joints of which detections are theirs in those that show
        them."""
        bones = self._bones.of_recognised(track.number, track.person, self._follower.builds.between_stays_m)
        n_cameras = self.rig.n_cameras
        shapes = {name: array.shape[1:] for image in images for name, array in image.arrays.items()}
        arrays = {name: np.full((n_cameras, *shape), NOTHING[name]) for name, shape in shapes.items()}
        time_s = np.full(n_cameras, np.nan)
        for image in images:
            c = self.rig.names.index(image.camera)
            time_s[c] = image.time_s
            if image.camera in seen:
                for name, values in image.of_person(*seen[image.camera]).items():
                    arrays[name][c] = values
        if len(images) == 1 and n_cameras > 1:
            c = self.rig.names.index(images[0].camera)
            of_camera = {name: each[c] for name, each in arrays.items()}
            return NewDetections(images[0].camera, images[0].time_s, of_camera, bones)
        return NewDetections(None, time_s, arrays, bones)
