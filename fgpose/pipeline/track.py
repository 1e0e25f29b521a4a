"""Running the online estimators over a recording, as if it were live."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from jaxtyping import Float

from fgpose.association.recording import Association, Progress
from fgpose.association.track import TrackEvent
from fgpose.config import Config
from fgpose.correspondences import Seen, SeenInImage
from fgpose.estimation.estimator import Estimator
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.reprojection import reprojection_residual_px
from fgpose.observations import Observations
from fgpose.people_observations import Detections, PeopleObservations
from fgpose.pipeline.result import Result
from fgpose.pipeline.source import AnySource, Source
from fgpose.sampling import nearest
from fgpose.tracking import Tracked, Tracker
from fgpose.trajectory import Estimate, Trajectory
from fgpose.viewer import Recording


def run_track(
    source: AnySource, config: Config, progress: Progress | None = None, viewer: Recording | None = None
) -> Result:
    """The online estimator, or the tracker of everybody, fed with a recording frame by frame as if it were live.

    Args:
        source: the recording, of one person or of everybody.
        config: the parameters.
        progress: told after every frame.
        viewer: shows each update as soon as it is made.

    Returns:
        "online": the newest estimates after each update; "smoothed": those of each frame one lag later, of everybody
        who was followed for so long (no such trajectories where nobody was). A person has the number that the tracker
        gave at that time; its events say when it recognised somebody, and which number then became which.

    Raises:
        ValueError: so many frames make no body that the calibration must be wrong.
    """
    observations, names = source.observations, source.rig.names
    time_s = observations.frame_time_s + source.rig.common_offset_s
    estimates: list[Mapping[int, Estimate]] = []
    update_ms = np.zeros(len(time_s))
    replay: _OfOne | _OfEverybody = (
        _OfEverybody(observations, source.rig, config)
        if isinstance(observations, PeopleObservations)
        else _OfOne(source, config)
    )
    with replay:
        for frame, update in enumerate(replay):
            start_s = time.perf_counter()
            estimates.append(update())
            update_ms[frame] = 1000 * (time.perf_counter() - start_s)
            if viewer is not None:
                replay.show(viewer, frame, float(update_ms[frame]))
            if progress:
                progress(frame + 1, len(time_s))
    trajectories = {"online": _by_person(estimates, time_s, names, config)}
    if lagged := _by_person(estimates, time_s, names, config, lagged=True):
        trajectories = {"smoothed": replay.completed(lagged), **trajectories}
    saved = "smoothed", "online"
    return Result(source, config, trajectories, saved, replay.association, update_ms, _n_repairs(estimates))


Update = Callable[[], Mapping[int, Estimate]]
"""Gives the newest estimate of everybody, by the number of the person."""


class _OfOne:
    """The estimator, fed with one person's frames."""

    association = None

    def __init__(self, source: Source[Observations], config: Config) -> None:
        self._observations, self._rig, self._evidence = source.observations, source.rig, source.evidence(config)
        self._estimator = Estimator(self._rig, self._observations.skeleton, config, times_are_checked=True)
        if source.bones is not None:
            self._estimator.know(source.bones)

    def __enter__(self) -> _OfOne:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def __iter__(self) -> Iterator[Update]:
        return (partial(self._update, seen) for seen in self._observations)

    def _update(self, seen: Observations) -> Mapping[int, Estimate]:
        self._seen, self._newest = seen, self._estimator.update(seen)
        return {0: self._newest}

    def show(self, viewer: Recording, frame: int, update_ms: float) -> None:
        viewer.log_estimate(self._newest, self._seen, self._evidence.weights[frame], update_ms=update_ms)

    def completed(self, lagged: Mapping[int, Trajectory]) -> Mapping[int, Trajectory]:
        """With reprojection errors, and with the frames that were left out: lagged estimates have neither."""
        evidence = self._evidence.frames(slice(0, lagged[0].n_frames))
        residual_px = reprojection_residual_px(evidence.undistorted_px, self._rig, lagged[0].positions_m)
        return {0: replace(lagged[0], residual_px=residual_px, implausible_frames=evidence.implausible_frames)}


class _OfEverybody:
    """The tracker, fed with everybody's images."""

    def __init__(self, people: PeopleObservations, rig: CameraRig, config: Config) -> None:
        self._people, self._rig = people, rig
        self._tracker = Tracker(rig, people.skeleton, config)
        self._tracked: list[list[Tracked]] = []
        self._events: list[TrackEvent] = []

    def __enter__(self) -> _OfEverybody:
        return self

    def __exit__(self, *_: object) -> None:
        self._tracker.close()

    def __iter__(self) -> Iterator[Update]:
        return (partial(self._update, images) for images in self._people)

    def _update(self, images: list[Detections]) -> Mapping[int, Estimate]:
        self._images, people = images, self._tracker.update(images) if images else []
        self._tracked.append(people)
        self._new_events = self._tracker.events()
        self._events += self._new_events
        return {each.person: each.estimate for each in people}

    def show(self, viewer: Recording, frame: int, update_ms: float) -> None:
        viewer.log_tracked(frame, self._images, self._tracked[-1], self._new_events)

    def completed(self, lagged: Mapping[int, Trajectory]) -> Mapping[int, Trajectory]:
        return lagged

    @property
    def association(self) -> Association:
        """Whom each detection was taken for at that time."""
        names = self._rig.names
        seen: dict[int, list[SeenInImage]] = {}
        for frame, people in enumerate(self._tracked):
            for each in people:
                of_frame = [(frame, names.index(camera), *joints) for camera, joints in each.seen.items()]
                seen.setdefault(each.person, []).extend(of_frame)
        of_person = {person: Seen.of_images(own, len(names)) for person, own in seen.items() if own}
        return Association(self._people, self._rig, of_person, tuple(self._events))


def _n_repairs(estimates: Sequence[Mapping[int, Estimate]]) -> int:
    """Of all estimators. One that begins anew counts from 0 again."""
    total, before = 0, dict[int, int]()
    for people in estimates:
        for person, estimate in people.items():
            total += max(estimate.n_repairs - before.get(person, 0), 0)
            before[person] = estimate.n_repairs
    return total


def _by_person(
    estimates: Sequence[Mapping[int, Estimate]],
    time_s: Float[np.ndarray, " frame"],
    camera_names: tuple[str, ...],
    config: Config,
    *,
    lagged: bool = False,
) -> dict[int, Trajectory]:
    """From the first to the last frame of each person; of one frame the last estimate counts."""
    by_person: dict[int, dict[int, Estimate]] = {}
    for frame, people in enumerate(estimates):
        for person, newest in people.items():
            lengths = {"bone_lengths": newest.bone_lengths, "other_bone": newest.other_bone}
            for estimate in newest.newly_smoothed if lagged else (newest,):
                at = int(nearest(np.array([estimate.time_s]), time_s)[0]) if lagged else frame
                by_person.setdefault(person, {})[at] = replace(estimate, frame=at, time_s=float(time_s[at]), **lengths)
    trajectories = {}
    for person, own in sorted(by_person.items()):
        frames = np.array(sorted(own))
        known = Trajectory.from_estimates([own[frame] for frame in frames.tolist()], camera_names, config)
        there = np.arange(frames[0], frames[-1] + 1)
        trajectories[person] = replace(known.in_frames(time_s[there], frames - frames[0]), frame_numbers=there)
    return trajectories
