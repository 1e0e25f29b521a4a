"""What is up in the world of trajectories that are written or read, where the caller leaves it to be found."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from pathlib import Path

from fgpose.geometry.camera import CameraRig
from fgpose.geometry.up_axis import UpAxis, UpChoice, WorldUp
from fgpose.kinematics.vertical import find_up, question_up
from fgpose.trajectory import Trajectory


def resolved_up(
    people: Iterable[Trajectory],
    world_up: UpChoice | WorldUp,
    path: Path,
    rig: CameraRig | None = None,
    usual: UpAxis = "+z",
) -> WorldUp:
    """What is up: as the caller says, or as bodies and cameras stand.

    Args:
        people: everybody in the recording.
        world_up: what the caller says.
        path: the file that the remark is about.
        rig: the cameras in the same world, if they are known.
        usual: the axis that is up where nothing speaks against it.

    Warns:
        UserWarning: auto found another axis up than usual, or is in doubt.
    """
    if world_up != "auto":
        return world_up
    found = find_up(people, rig, usual)
    if found.remark:
        warnings.warn(f"{path}: {found.remark}", UserWarning, stacklevel=3)
    return found.world_up


def doubt_given_up(
    people: Iterable[Trajectory], given: WorldUp, path: Path, rig: CameraRig | None = None, option: str = "--world-up"
) -> None:
    """Say it where bodies and cameras contradict what a user says is up; arguments as of question_up, and the file that
    it is about.

    Warns:
        UserWarning: they do.
    """
    questioned = question_up(given, people, rig, option)
    if questioned is not None:
        warnings.warn(f"{path}: {questioned.reason}. {questioned.remedy}", UserWarning, stacklevel=4)
