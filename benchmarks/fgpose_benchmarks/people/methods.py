"""The methods of the benchmark of several people, each on the same detections."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from fgpose.config import Config, OnlineConfig, SolverConfig, TrackingConfig
from fgpose.tracking import Tracker, smooth_people
from fgpose_benchmarks.comparison.recording import Method
from fgpose_benchmarks.people.baselines.cross_view import cross_view
from fgpose_benchmarks.people.baselines.greedy import greedy
from fgpose_benchmarks.people.baselines.rapid_pose import rapid_pose
from fgpose_benchmarks.people.recording import PeopleMethod, PeopleRecording, PeopleResult, Poses, trajectories
from fgpose_benchmarks.people.truth import true_association

POSITIONS_ONLY = Config(
    solver=SolverConfig(covariance=False),
    online=OnlineConfig(covariance=False),
    tracking=TrackingConfig(max_processes=1),
)
"""The defaults without the covariance of the result, which no other method states; in one process, as its time is
measured."""


@dataclass(frozen=True)
class FrameByFrame:
    """A method that says who is where in every frame."""

    solve: Callable[[PeopleRecording], list[Poses]]

    def __call__(self, recording: PeopleRecording) -> PeopleResult:
        start_s = time.process_time()
        poses = self.solve(recording)
        cpu_s = time.process_time() - start_s
        return PeopleResult(trajectories(recording.observations.skeleton, recording.frames.frame_time_s, poses), cpu_s)


def _online(config: Config, recording: PeopleRecording) -> PeopleResult:
    """Everybody at the time of each frame, from the images up to it."""
    start_s, skeleton = time.process_time(), recording.observations.skeleton
    tracker = Tracker(recording.rig, skeleton, config)
    frames = (tracker.update(images) for _, images in recording.images())
    poses = [{each.person: each.estimate.positions_m for each in tracked} for tracked in frames]
    cpu_s, people = time.process_time() - start_s, trajectories(skeleton, recording.frames.frame_time_s, poses)
    return PeopleResult(people, cpu_s, tuple(tracker.events()))


def batch(config: Config, recording: PeopleRecording) -> PeopleResult:
    """fgpose.smooth_people with this configuration."""
    start_s = time.process_time()
    smoothed = smooth_people(recording.observations, recording.rig, config)
    return PeopleResult(smoothed.trajectories, time.process_time() - start_s)


def _told(config: Config, recording: PeopleRecording) -> PeopleResult:
    """The batch that is told who is who."""
    known = true_association(recording)
    start_s = time.process_time()
    smoothed = smooth_people(recording.observations, recording.rig, config, association=known)
    return PeopleResult(smoothed.trajectories, time.process_time() - start_s)


TOLD = Method("told who is who", "oracle", partial(_told, POSITIONS_ONLY))

METHODS: tuple[PeopleMethod, ...] = (
    Method("greedy triangulation", "baseline", FrameByFrame(greedy)),
    Method("RapidPose-like", "baseline", FrameByFrame(rapid_pose)),
    Method("Chen-like", "baseline", FrameByFrame(cross_view)),
    Method("fgpose online", "ours", partial(_online, POSITIONS_ONLY)),
    Method("fgpose batch", "ours", partial(batch, POSITIONS_ONLY)),
    TOLD,
)
