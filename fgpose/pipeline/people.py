"""Several people: reading everybody in a recording, and running the smoother or the online estimators over it."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from fgpose.association.chosen_person import PersonRegion, chosen_person, main_person
from fgpose.association.recording import Association, Progress
from fgpose.association.successive import Succession, successive
from fgpose.association.track import TrackEvent
from fgpose.config import Config
from fgpose.diagnosis.diagnose import Diagnosis
from fgpose.frame_matching import NO_IMAGE
from fgpose.geometry.camera import CameraRig
from fgpose.io.origin import Origin
from fgpose.parameters import TrackingConfig
from fgpose.people import Detections, PeopleObservations, Seen, SeenInImage
from fgpose.pipeline.source import Source, with_findings
from fgpose.sampling import nearest
from fgpose.tracking import Tracked, Tracker, smooth_people
from fgpose.trajectory import Estimate, Trajectory

OnTracked = Callable[[int, Sequence[Detections], Sequence[Tracked], Sequence[TrackEvent]], None]
"""Called after each update with the frame, its images, the people and the events, as PeopleRecording.log_tracked."""


@dataclass(frozen=True, eq=False)
class PeopleSource:
    """A recording of any number of people: its cameras and what they saw."""

    rig: CameraRig
    people: PeopleObservations
    origin: Origin | None = None
    """Where it is from, if that is known."""

    association: Association | None = None
    """Who is who, where that is known already."""
    succession: Succession | None = None
    """Who comes after whom, where no image shows more than one person."""

    def one(self, person: int | PersonRegion = 0) -> Source:
        """The main person, see chosen_person; or another one. Raises ValueError if there is no such person."""
        chosen = main_person(self.people, self.rig) if person == 0 else chosen_person(self.people, self.rig, person)
        origin = self.origin and replace(self.origin, chosen=str(chosen))
        return Source(self.rig, self.people.of_person(chosen.seen), origin, chosen)

    def one_or_all(self, config: TrackingConfig | None = None) -> Source | PeopleSource:
        """Everybody where an image shows more than one, or where somebody comes after somebody else has gone; else the
        one who is there."""
        if self.people.n_most > 1:
            return self
        succession = successive(self.people, self.rig, config)
        if succession is None or succession.n_people == 1:
            one = self.people.of_person(self.people.only())
            return Source(self.rig, one, self.origin, succession=succession)
        return replace(self, association=succession.association, succession=succession)

    def subset(self, cameras: tuple[str, ...]) -> PeopleSource:
        """Some of the cameras, all if none is named. Raises ValueError for an unknown name."""
        if not cameras:
            return self
        return PeopleSource(self.rig.subset(cameras), self.people.subset(cameras), self.origin)

    def confident(self, least: float) -> PeopleSource:
        """Without the detections of less confidence. Raises ValueError unless it lies in [0, 1]."""
        return replace(self, people=self.people.confident(least))

    def first_frames(self, n_frames: int) -> PeopleSource:
        """The beginning of the recording."""
        return PeopleSource(self.rig, self.people.first_frames(n_frames), self.origin)


@dataclass(frozen=True, eq=False)
class PeopleResult:
    """The motion of everybody."""

    source: PeopleSource
    config: Config
    association: Association
    trajectories: Mapping[str, Mapping[int, Trajectory]]
    """By name ("smoothed", "online"), the most important last; of each by the number of the person."""
    saved: tuple[str, ...]
    """Names of those that are written; one that the run did not give is left out."""
    update_ms: Float[np.ndarray, " frame"] | None = None
    """How long each update of the tracker took, milliseconds."""
    diagnosis: Diagnosis | None = None
    """What is probably wrong with it (fgpose.pipeline.diagnosed); None: nobody has looked."""

    @property
    def main(self) -> Mapping[int, Trajectory]:
        """The most important trajectories."""
        return list(self.trajectories.values())[-1]

    @property
    def origin(self) -> Origin | None:
        """That of the source, with what happened to the tracks and what is probably wrong."""
        origin = with_findings(self.source.origin, self.diagnosis)
        return None if origin is None else replace(origin, events=self.association.events)

    def first_frame(self, trajectory: Trajectory) -> int:
        """The frame of the recording in which a trajectory begins."""
        return int(nearest(trajectory.time_s[:1], self.association.frames.frame_time_s)[0])


def run_smooth_people(source: PeopleSource, config: Config, progress: Progress | None = None) -> PeopleResult:
    """The batch smoother over a whole recording of several people."""
    known = source.association
    if known is not None:
        # The cameras may have been calibrated since.
        known = replace(known, rig=source.rig.subset(source.people.camera_names), observations=source.people)
    smoothed = smooth_people(source.people, source.rig, config, progress, known)
    return PeopleResult(source, config, smoothed.association, {"smoothed": smoothed.trajectories}, ("smoothed",))


def run_track_people(
    source: PeopleSource, config: Config, progress: Progress | None = None, on_update: OnTracked | None = None
) -> PeopleResult:
    """The tracker, fed with a recording frame by frame as if it were live.

    Returns:
        "online": the newest estimates after each update; "smoothed": those of each frame one lag later, of everybody
        who was tracked for so long (no such trajectories where nobody was). A person has the number that the tracker
        gave at that time; its events say when it recognised somebody.
    """
    frames, cameras = source.people.frames, source.rig.names
    tracked: list[list[Tracked]] = []
    events, update_ms = [], np.zeros(len(frames.image))
    with Tracker(source.rig, source.people.skeleton, config) as tracker:
        for frame, images in enumerate(_moments(source.people)):
            start_s = time.perf_counter()
            tracked.append(tracker.update(images) if images else [])
            update_ms[frame] = 1000 * (time.perf_counter() - start_s)
            new_events = tracker.events()
            events += new_events
            if on_update:
                on_update(frame, images, tracked[-1], new_events)
            if progress:
                progress(frame + 1, len(frames.image))
    seen: dict[int, list[SeenInImage]] = {}
    for frame, people in enumerate(tracked):
        for each in people:
            of_frame = [(frame, cameras.index(camera), *joints) for camera, joints in each.seen.items()]
            seen.setdefault(each.person, []).extend(of_frame)
    of_person = {person: Seen.of_images(own, len(cameras)) for person, own in seen.items() if own}
    association = Association(source.people, source.rig, of_person, tuple(events))
    trajectories = {"online": _by_person(tracked, source, config, lagged=False)}
    if lagged := _by_person(tracked, source, config, lagged=True):
        trajectories = {"smoothed": lagged, **trajectories}
    return PeopleResult(source, config, association, trajectories, ("smoothed", "online"), update_ms)


def _moments(people: PeopleObservations) -> Sequence[list[Detections]]:
    """The images of each frame."""
    by_camera = [people.by_camera[name] for name in people.camera_names]
    return [
        [images[i] for images, i in zip(by_camera, of_frame, strict=True) if i != NO_IMAGE]
        for of_frame in people.frames.image.tolist()
    ]


def _by_person(
    tracked: list[list[Tracked]], source: PeopleSource, config: Config, *, lagged: bool
) -> dict[int, Trajectory]:
    """From the first to the last frame of each person; of one frame the last estimate counts."""
    time_s = source.people.frames.frame_time_s
    estimates: dict[int, dict[int, Estimate]] = {}
    for frame, people in enumerate(tracked):
        for each in people:
            estimate = each.estimate.smoothed if lagged else each.estimate
            if estimate is not None:
                at = int(nearest(np.array([estimate.time_s]), time_s)[0]) if lagged else frame
                estimates.setdefault(each.person, {})[at] = replace(estimate, frame=at, time_s=float(time_s[at]))
    trajectories = {}
    for person, own in sorted(estimates.items()):
        frames = np.array(sorted(own))
        known = Trajectory.from_estimates([own[frame] for frame in frames.tolist()], source.rig.names, config)
        trajectories[person] = known.in_frames(time_s[frames[0] : frames[-1] + 1], frames - frames[0])
    return trajectories
