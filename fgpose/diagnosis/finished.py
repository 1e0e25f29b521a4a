"""A finished recording: what the estimator made of it, and what is still known of what it was made from. Its world has
z up."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import wraps
from pathlib import Path

import numpy as np
from jaxtyping import Float

from fgpose.association.track import TrackEvent
from fgpose.calibration.from_people.calibrated import CalibrationFinding
from fgpose.estimation.evidence.delays import image_motion_px
from fgpose.finding import Finding
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.up_axis import WorldUp
from fgpose.observations import Observations
from fgpose.trajectory import Trajectory


@dataclass(frozen=True)
class Mark:
    """Something that happened, as whoever recorded it has noted."""

    time_s: float
    """By the clock of the recording."""
    name: str


@dataclass(frozen=True, eq=False)
class FinishedRecording:
    """The results of one recording. All that is not a trajectory may be missing: what rests on it is then not judged.

    Raises:
        ValueError: there is nobody, somebody has no frame, people differ in skeleton or cameras, the rig lacks a
            camera, or observations do not have the frames of their trajectory.
    """

    name: str
    people: Mapping[int, Trajectory]
    """By the number of the person."""
    rig: CameraRig | None = None
    """The cameras of the trajectories, in any order."""
    observations: Mapping[int, Observations] = field(default_factory=dict)
    """What the cameras saw of each person, in the frames of the trajectory; of those for whom it is known. Where it has
    a time for each camera, that is by the clock of the rig; else no camera is late."""
    offset_sigma_s: Mapping[str, float] = field(default_factory=dict)
    """Standard deviation of the time offset of each camera whose offset was estimated; the offsets are the rig's."""
    findings: tuple[CalibrationFinding, ...] = ()
    """Of the calibration, if the rig is from one from people or with a board."""
    calibrated: str = ""
    """How it was: "from people", "with a board"; empty: not known."""
    board_coverage: Mapping[str, tuple[tuple[int, ...], ...]] = field(default_factory=dict)
    """Of each camera that was calibrated with a board: corners in the parts of its image, in rows from the top."""
    known_findings: tuple[Finding, ...] = ()
    """What was found when it was estimated."""
    given_up: WorldUp | None = None
    """What somebody said to be up in the world that it was turned from; None: it was found."""
    estimated: tuple[str, ...] = ()
    """What of the cameras was estimated on the recording before: poses, clocks."""
    events: tuple[TrackEvent, ...] = ()
    """Of the tracks of people."""
    marks: tuple[Mark, ...] = ()
    """Events of the recording itself, in the order of time."""
    videos: Path | None = None
    """Folder of the videos, or of the folders of images, of the cameras."""
    images_hz: float | None = None
    """Images per second, where folders of images are given; overrides what videos say."""
    made_from: Mapping[str, str] = field(default_factory=dict)
    """What it was made from and with, as it is to be read: {"Keypoints": "pose/", ...}."""

    def __post_init__(self) -> None:
        if not self.people:
            raise ValueError(f"recording {self.name}: there is nobody in it")
        first = next(iter(self.people.values()))
        for person, trajectory in self.people.items():
            if not trajectory.n_frames:
                raise ValueError(f"recording {self.name}: person {person} has no frame")
            if (trajectory.skeleton, trajectory.camera_names) != (first.skeleton, first.camera_names):
                raise ValueError(f"recording {self.name}: person {person} has another skeleton or other cameras")
            seen = self.observations.get(person)
            if seen is not None and seen.points2d_px.shape[:3] != _shape(trajectory):
                raise ValueError(
                    f"recording {self.name}: the observations of person {person} have frames, cameras, joints "
                    f"{seen.points2d_px.shape[:3]}, the trajectory {_shape(trajectory)}"
                )
        if self.rig is not None and first.camera_names:
            object.__setattr__(self, "rig", self.rig.subset(first.camera_names))

    @property
    def main_person(self) -> int:
        """Of whom most is seen by two cameras."""
        return max(self.people, key=lambda person: int(self.people[person].observed.sum()))

    @property
    def main(self) -> Trajectory:
        """The trajectory of that person."""
        return self.people[self.main_person]

    @property
    def camera_names(self) -> tuple[str, ...]:
        return self.main.camera_names or (self.rig.names if self.rig is not None else ())

    def on_time_px(self, person: int) -> Float[np.ndarray, "frame camera joint 2"]:
        """The detections of a person who has observations, undistorted, where they would be if every image had been
        taken at the time of its frame: those of a camera that is known to be late are moved by the motion."""
        trajectory, seen, rig = self.people[person], self.observations[person], self.rig
        assert rig is not None
        undistorted_px = rig.undistort(seen.points2d_px)
        if seen.time_s.ndim == 1:
            return undistorted_px
        # The times are by the clock of the rig: they hold its offsets already.
        delay_s = np.nan_to_num(seen.time_s - trajectory.time_s[:, None])
        return undistorted_px - image_motion_px(trajectory.positions_m, trajectory.time_s, delay_s, rig)

    def number(self, person: int) -> int | None:
        """Of a person, where there are several."""
        return person if len(self.people) > 1 else None

    def prefix(self, person: int) -> str:
        """Before what is said of a person; nothing where there is only one."""
        return f"{self.called(person)}: " if self.called(person) else ""

    def called(self, person: int) -> str:
        """How a person is named; nothing where there is only one."""
        return f"person {person}" if len(self.people) > 1 else ""


def of_each_person(
    check: Callable[[FinishedRecording, int, Trajectory], Finding | None],
) -> Callable[[FinishedRecording], list[Finding]]:
    """A check of a recording from one of a person in it, by number, and their trajectory: None if nothing is found."""

    @wraps(check)
    def of_everybody(recording: FinishedRecording) -> list[Finding]:
        found = ((person, check(recording, person, each)) for person, each in recording.people.items())
        return [replace(each, person=recording.number(person)) for person, each in found if each is not None]

    return of_everybody


def _shape(trajectory: Trajectory) -> tuple[int, int, int]:
    return trajectory.n_frames, len(trajectory.camera_names), trajectory.skeleton.n_joints
