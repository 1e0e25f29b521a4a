"""File formats that other packages add: entry points of the group fgpose.formats (docs/extending.md)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from fgpose.extensions import added
from fgpose.geometry.camera import CameraRig
from fgpose.people_observations import PeopleObservations
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Trajectory


@dataclass(frozen=True)
class KeypointFormat:
    """Keypoints of all cameras. What a function cannot read, it refuses with ValueError or OSError."""

    recognises: Callable[[Path], bool]
    """Whether a file or folder is of this format, by its content."""
    camera_names: Callable[[Path], tuple[str, ...]]
    read: Callable[[Path, CameraRig, Skeleton], PeopleObservations]
    """Of the cameras of the rig, in its order; PeopleObservations.of_one makes them of one person."""


@dataclass(frozen=True)
class RigFormat:
    """Calibrations. What a function cannot read, it refuses with ValueError or OSError."""

    recognises: Callable[[Path], bool]
    """Whether a file or folder is of this format, by its content."""
    read: Callable[[Path], CameraRig]


@dataclass(frozen=True)
class TrajectoryFormat:
    """The motion of one person, in files with an extension of their own."""

    extension: str
    """With its point, in lower case."""
    write: Callable[[Trajectory, Path], None]
    """To a file that is not there yet, and that gets its name once it is whole."""
    read: Callable[[Path], Trajectory]

    def check(self, path: Path) -> None:
        """Whether a file that was written is whole. Raises as read."""
        self.read(path)


_Recognised = TypeVar("_Recognised", KeypointFormat, RigFormat)


def recognised(kind: type[_Recognised], path: Path) -> _Recognised | None:
    """The format of a kind that knows the file; None: it is none of those that others add."""
    formats = (each for each in added("fgpose.formats").values() if isinstance(each, kind))
    return next((each for each in formats if each.recognises(path)), None)


def trajectory_formats() -> dict[str, TrajectoryFormat]:
    """By their extensions."""
    formats = (each for each in added("fgpose.formats").values() if isinstance(each, TrajectoryFormat))
    return {each.extension: each for each in formats}
