"""Input and output of the methods of the benchmark of several people."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.association.track import TrackEvent
from fgpose.correspondences import MatchedFrames
from fgpose.geometry.camera import CameraRig
from fgpose.people_observations import Detections, PeopleObservations
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Trajectory, joint_status
from fgpose_benchmarks.comparison.recording import Method
from fgpose_benchmarks.synthetic import CrowdScene


@dataclass(frozen=True, eq=False)
class PeopleRecording:
    """A recording of several people whose truth is known. Methods see the observations and the rig; the rest is for
    scoring and for the method that is told who is who."""

    clip: str
    """Name of the draw of people, of their motion and of the errors."""
    variant: str
    scene: CrowdScene

    @property
    def frames(self) -> MatchedFrames:
        """Images of about the same time; the people are asked for at the times of these frames."""
        return self.observations.frames

    @property
    def observations(self) -> PeopleObservations:
        return self.scene.observations

    @property
    def rig(self) -> CameraRig:
        return self.scene.rig

    @property
    def truth(self) -> dict[int, Trajectory]:
        """By true identity, at the times of the frames."""
        return self.scene.truth(self.frames.frame_time_s)

    def images(self) -> Iterator[tuple[float, list[Detections]]]:
        """Time of each frame, and its images in the order of the cameras."""
        return zip(self.frames.frame_time_s.tolist(), self.observations, strict=True)


Poses = Mapping[int, Float[np.ndarray, "joint 3"]]
"""Everybody in one frame, by identity; world frame, metres, NaN: not known."""


@dataclass(frozen=True, eq=False)
class PeopleResult:
    """What a method made of a recording."""

    people: Mapping[int, Trajectory]
    """By identity."""
    cpu_s: float
    """Processor time for all frames."""
    events: tuple[TrackEvent, ...] = ()
    """That say which numbers were revised."""


PeopleMethod = Method[PeopleRecording, PeopleResult]
"""One line of the tables; its group is baseline, ours or oracle."""


def trajectories(
    skeleton: Skeleton, time_s: Float[np.ndarray, " frame"], poses: Sequence[Poses]
) -> dict[int, Trajectory]:
    """Everybody over time, from everybody in each frame."""
    people = sorted({person for of_frame in poses for person in of_frame})
    positions_m = {person: np.full((len(time_s), skeleton.n_joints, 3), np.nan) for person in people}
    for t, of_frame in enumerate(poses):
        for person, pose_m in of_frame.items():
            positions_m[person][t] = pose_m
    return {person: _trajectory(skeleton, time_s, own_m) for person, own_m in positions_m.items()}


def _trajectory(
    skeleton: Skeleton, time_s: Float[np.ndarray, " frame"], positions_m: Float[np.ndarray, "frame joint 3"]
) -> Trajectory:
    known = np.asarray(np.isfinite(positions_m).all(axis=-1))
    return Trajectory(skeleton, time_s.copy(), positions_m, joint_status(known, known))
