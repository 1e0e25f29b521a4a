"""Everybody who is there, from images as they come: grouped, given to the tracker, and told at any time."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Collection, Sequence, Set
from dataclasses import dataclass, replace

import numpy as np

from fgpose.association.track import Tracked, TrackEvent
from fgpose.config import Config
from fgpose.finding import Code
from fgpose.geometry.camera import CameraRig
from fgpose.io.live.recordings import RecordedImage
from fgpose.io.live.tracker_memory import TrackerMemory
from fgpose.live.cameras.frozen_keypoints import are_same
from fgpose.live.frame import CameraStatus, LiveFrame, LiveJudgement, LivePerson, Restarts
from fgpose.live.processes.parts import Parts
from fgpose.live.tracking.agreement import CameraAgreement
from fgpose.live.tracking.known import Known, KnownCamera, UsualAge
from fgpose.live.tracking.moments import Moments
from fgpose.live.tracking.newest_views import NewestViews
from fgpose.live.tracking.observed import ObservedVolume
from fgpose.people_observations import Detections
from fgpose.skeleton import Skeleton
from fgpose.tracking import Tracker

# Of a process of estimators; usually it takes some milliseconds.
_ANSWERS_WITHIN_S = 1.0
# At the processes of the tracker; two looks tell that one is stopped.
_LOOKS_S = 0.1
# Who came while there was no image for longer is not found yet.
_GAP_S = 0.5


@dataclass(frozen=True, eq=False)
class Update:
    """What the tracker was given together, and what it said."""

    images: tuple[RecordedImage, ...]
    people: tuple[Tracked, ...]
    events: tuple[TrackEvent, ...]


class LiveTracking:
    """The tracker of a live system. It is used from one thread, but for frame_without_news.

    Images of one moment are given together; one that comes later than its moment is still used at its own time, unless
    it is older than the lag. One that shows everybody at the very pixels of the one before is not used. Where the times
    of a camera are not those of this computer's clock, everybody's motion tells how late it is beyond them. A tracker
    that fails is replaced by a new one.

    Args:
        rig, skeleton, config: as of fgpose.Tracker.
        volume_m: (N, 3) points of the volume of which frames say how much is observed.
        parts: told when the tracker or one of its processes has ended.
        memory: of a system before, whose people may be recognised.
    """

    def __init__(
        self,
        rig: CameraRig,
        skeleton: Skeleton,
        config: Config,
        volume_m: np.ndarray,
        parts: Parts | None = None,
        memory: TrackerMemory | None = None,
    ) -> None:
        self._parts = parts or Parts()
        self.rig, self.skeleton = rig, skeleton
        self.config = config.replace(online={"estimate_time_offsets": True})
        self._time_sigma_s = np.zeros(rig.n_cameras)
        self._memory = memory
        self._volume = ObservedVolume(rig, volume_m)
        self._tracker = self._new_tracker()
        self._tracker.await_ready()
        self._views = NewestViews(rig.names)
        self._agreement = CameraAgreement(rig)
        self._moments = Moments()
        self._arrived: dict[tuple[str, float], RecordedImage] = {}
        self._image_s: dict[str, float] = {}
        self._usual_age = UsualAge()
        self._last: dict[str, Detections] = {}
        """The newest of each camera that were not refused."""
        self._frame_s = -np.inf
        """Of the people as they are known."""
        self._people: tuple[LivePerson, ...] = ()
        self._since_s = np.nan
        """When the first image was taken that the tracker has used."""
        self._looked_s = -np.inf
        self._n_repairs: dict[int, int] = {}
        """Of the estimator of each person, so far."""
        self._n_used: Counter[str] = Counter()
        self._n_lost: Counter[str] = Counter()
        self._sequence = itertools.count()
        self._known = self._now_known()
        """As the last frame says it."""
        self.on_taken: Callable[[Collection[str]], None] = lambda camera_names: None
        """Told of the cameras whose detections are about to be used, or are lost."""
        self.n_failures = 0
        """How often the tracker was replaced."""

    @property
    def newest_s(self) -> float:
        """When the newest image was taken that was used; -inf: none was."""
        return max(self._image_s.values(), default=-np.inf)

    @property
    def deadline_s(self) -> float:
        """When images that wait for others have waited long enough; inf: none waits."""
        return self._moments.deadline_s

    def add(self, image: RecordedImage, now_s: float) -> list[Update]:
        """Take the detections of an image, unless they are not to be used; what it completes is tracked."""
        detections = image.detections
        key = detections.camera, detections.time_s
        is_of_set_clock = self._tracker.leaves_out(detections.arriving(image.arrived_s))
        is_again = detections.time_s <= self._image_s.get(detections.camera, -np.inf) and not is_of_set_clock
        is_again |= key in self._arrived
        # A picture or a detector that has stopped: with a new stamp, people would be where they were a while ago.
        is_again |= detections.camera in self._last and are_same(self._last[detections.camera], detections)
        if not image.is_used or is_again or self._is_too_old(detections):
            self._n_lost[detections.camera] += 1
            self.on_taken([detections.camera])
            return [Update((replace(image, is_used=False),), (), ())]
        self._arrived[key] = image
        self._last[detections.camera] = detections
        if is_of_set_clock and detections.camera in self._tracker.set_clocks:  # it is of no moment
            return [self._tracked([detections])]
        return [self._tracked(moment) for moment in self._moments.add(detections, now_s)]

    def look(self, now_s: float, expected: Collection[str]) -> list[Update]:
        """Track what waits, if all of these cameras have come or it has waited long enough. Processes that have ended
        are replaced, also where nothing comes."""
        self._look_at_processes(now_s)
        moment = self._moments.ready(now_s, set(expected) - self._tracker.set_clocks.keys())
        return [self._tracked(moment)] if moment else []

    def frame(
        self,
        now_s: float,
        cameras: Sequence[CameraStatus],
        restarts: tuple[Restarts, ...] = (),
        diagnosis: LiveJudgement | None = None,
    ) -> LiveFrame:
        """What can be said now. The images of the cameras that were used, or not, are added to their statuses, and what
        a diagnosis says of them."""
        self._usual_age.add(self.newest_s, now_s)
        self._known = self._now_known()
        return self.frame_without_news(now_s, cameras, restarts, diagnosis)

    def frame_without_news(
        self,
        now_s: float,
        cameras: Sequence[CameraStatus],
        restarts: tuple[Restarts, ...] = (),
        diagnosis: LiveJudgement | None = None,
    ) -> LiveFrame:
        """What could be said when frame was last asked, at a later time. Any thread may ask, whatever hangs."""
        return self._known.frame(next(self._sequence), now_s, cameras, restarts, diagnosis)

    def observed_share(self, cameras: Sequence[CameraStatus]) -> float:
        """Of the volume, by at least two of the cameras that are ok."""
        return self._volume.share(cameras)

    def tidy(self) -> None:
        """Do what can be done before the next images come. To be called when what is known has been published."""
        try:
            self._tracker.tidy()
        except Exception as error:
            self._begin_anew(error)
        try:
            self._compare_cameras()
        except Exception as error:
            self._parts.restarted("comparing the cameras", f"{type(error).__name__}: {error}", error)
            self._agreement = CameraAgreement(self.rig)

    def restart(self) -> None:
        """Forget images that wait and who people are, after something has failed."""
        self._moments, self._arrived = Moments(), {}
        self._forget_people()
        self.on_taken(self.rig.names)

    def memory(self) -> TrackerMemory | None:
        """Of the tracker, see Tracker.memory; a new one goes on from what this last gave."""
        self._memory = self._tracker.memory() or self._memory
        return self._memory

    def close(self) -> None:
        """End the processes of the tracker."""
        self._tracker.close()

    def track(self, images: Sequence[RecordedImage]) -> Update:
        """Let the tracker take those of the images that are to be used, together."""
        given: Sequence[Detections] = [image.detections.arriving(image.arrived_s) for image in images if image.is_used]
        if not given:
            self._count(images, set())
            return Update(tuple(images), (), ())
        self._know_clocks(images)
        n_restarts = self._tracker.n_restarts
        try:
            people = self._tracker.update(given)
            given = self._tracker.used
            self._say_restarts(n_restarts)
            self._say_repairs(people)
            views = self._views.add(given, people)
            self._people = tuple(LivePerson.of(*each) for each in zip(people, views, strict=True))
            events = self._tracker.events()
            if given:
                self._agreement.add(given, people)
                first_s = min(image.time_s for image in given)
                if np.isnan(self._since_s) or first_s > self.newest_s + _GAP_S:
                    self._since_s = first_s
        except Exception as error:
            self._begin_anew(error)
            people, events = [], []
        self._count(images, {image.camera for image in given})
        self._image_s |= {each.camera: each.time_s for each in given}
        self._frame_s = min((person.estimate.time_s for person in people), default=self.newest_s)
        return Update(tuple(images), tuple(people), tuple(events))

    def _count(self, images: Sequence[RecordedImage], used: Set[str]) -> None:
        for image in images:
            (self._n_used if image.detections.camera in used else self._n_lost)[image.detections.camera] += 1

    def _look_at_processes(self, now_s: float) -> None:
        if not 0 <= now_s - self._looked_s < _LOOKS_S:
            self._looked_s, n_restarts = now_s, self._tracker.n_restarts
            try:
                self._tracker.look()
            except Exception as error:
                self._begin_anew(error)
            else:
                self._say_restarts(n_restarts)

    def _say_restarts(self, n_before: int) -> None:
        for _ in range(self._tracker.n_restarts - n_before):
            self._parts.restarted("a process of estimators", "it ended or did not answer")

    def _say_repairs(self, people: Sequence[Tracked]) -> None:
        before, self._n_repairs = self._n_repairs, {each.person: each.estimate.n_repairs for each in people}
        for person, n_repairs in self._n_repairs.items():
            for _ in range(n_repairs - before.get(person, 0)):
                self._parts.restarted("the graph of an estimator", "GTSAM has failed")

    def _compare_cameras(self) -> None:
        """A part of the work, which is less than a millisecond."""
        if not self._agreement.is_due:
            self._agreement.go_on()
            return
        offsets, sigma_s = self._tracker.offsets, self._time_sigma_s
        if offsets.has_told:
            sigma_s = np.where(sigma_s > 0, offsets.relative(fits=True)[1], 0.0)
        self._agreement.look(offsets.rig().time_offsets_s, sigma_s)

    def _know_clocks(self, images: Sequence[RecordedImage]) -> None:
        for image in images:
            self._time_sigma_s[self.rig.names.index(image.detections.camera)] = image.time_sigma_s
        self._tracker.offsets.sigma_s = self._time_sigma_s.copy()

    def _tracked(self, moment: Sequence[Detections]) -> Update:
        self.on_taken([each.camera for each in moment])
        images = [self._arrived.pop((each.camera, each.time_s)) for each in moment]
        return self.track(
            [replace(image, is_used=False) if self._is_too_old(image.detections) else image for image in images]
        )

    def _begin_anew(self, error: Exception) -> None:
        self._parts.restarted("the tracker", f"{type(error).__name__}: {error}", error)
        self.n_failures += 1
        self._forget_people()

    def _forget_people(self) -> None:
        """A new tracker has found nobody yet."""
        self._people, self._since_s = (), np.nan
        self._views = NewestViews(self.rig.names)
        self._tracker.close()
        self._tracker = self._new_tracker()

    def _new_tracker(self) -> Tracker:
        return Tracker(self.rig, self.skeleton, self.config, answers_within_s=_ANSWERS_WITHIN_S, memory=self._memory)

    def _is_too_old(self, detections: Detections) -> bool:
        return detections.time_s < self.newest_s - self.config.online.lag_s

    def _said_of_clocks(self) -> dict[str, str]:
        """By camera, of those whose clocks were set."""
        return {name: f"{reason} [{Code.LATE_CAMERA}]" for name, reason in self._tracker.set_clocks.items()}

    def _now_known(self) -> Known:
        offsets = self._tracker.offsets
        offset_s, sigma_s = offsets.relative() if offsets.has_told else (None, None)
        cameras, faults = dict[str, KnownCamera](), self._agreement.faults | self._said_of_clocks()
        for c, name in enumerate(self.rig.names):
            known = KnownCamera(self._n_used[name], self._n_lost[name], fault=faults.get(name, ""))
            if offset_s is not None and sigma_s is not None and self._time_sigma_s[c] > 0:
                known = replace(known, motion_offset_s=float(offset_s[c]), motion_sigma_s=float(sigma_s[c]))
            cameras[name] = known
        return Known(
            skeleton=self.skeleton,
            volume=self._volume,
            people=self._people,
            time_s=self._frame_s if self._image_s else np.nan,
            newest_s=self.newest_s,
            longest_s=self._usual_age.longest_s,
            since_s=self._since_s,
            cameras=cameras,
            nobodys=tuple(self._tracker.nobodys.values()),
        )
