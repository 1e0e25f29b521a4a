"""Writing and showing the motion of several people."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float

from fgpose.geometry.up_axis import UpChoice, WorldUp
from fgpose.io.origin import Origin
from fgpose.io.trajectories import people_paths, save_people, save_trajectory
from fgpose.pipeline.people import PeopleResult
from fgpose.pipeline.results import Outputs, viewer_writers, write_all
from fgpose.trajectory import Trajectory
from fgpose.viewer import PeopleRecording

Display = Callable[[PeopleResult, PeopleRecording], None]


def show_people(result: PeopleResult, recording: PeopleRecording) -> None:
    """Show everything that is known of a result; see fgpose.viewer."""
    recording.log_association(result.association)
    for person, trajectory in result.main.items():
        recording.log_person(person, trajectory, result.first_frame(trajectory))


def write_people(
    result: PeopleResult, outputs: Outputs, viewer: PeopleRecording | None = None, display: Display = show_people
) -> tuple[Path, ...]:
    """Write a result in every format wanted and show it, as write_outputs: everybody in one parquet file, each person
    in files of their own in other formats (see save_people). Where one person was found the files are those of one.

    Returns:
        The files; without the .rrd file of a recording that stays open.

    Raises:
        OutputError: a file could not be written, whatever the reason. All others were.
    """
    outputs = outputs.standing(result.main.values(), result.association.rig, result.diagnosis)
    paths = outputs.trajectory_paths(result.saved).items()
    names = {path: name for path, name in paths if name in result.trajectories}
    time_s = result.association.frames.frame_time_s
    writers: dict[Path | str, Callable[[], object]] = {
        path: partial(_save, result.trajectories[name], path, outputs.world_up, time_s, outputs.origin(result.origin))
        for path, name in names.items()
    }
    people = result.source.people
    opened = partial(outputs.open_people_viewer, result.association.rig, people.skeleton, len(people.frames.image))
    written = write_all(writers | viewer_writers(result, outputs, viewer, opened, display))
    return tuple(
        path
        for target in written
        for path in (_files(target, result.trajectories[names[target]]) if target in names else (target,))
    )


def _save(
    people: Mapping[int, Trajectory],
    path: Path,
    world_up: UpChoice | WorldUp,
    time_s: Float[np.ndarray, " frame"],
    origin: Origin | None,
) -> None:
    if len(people) == 1:
        (alone,) = people.values()
        save_trajectory(alone, path, world_up, origin)
    else:
        save_people(people, path, world_up, time_s, origin)


def _files(path: Path, people: Mapping[int, Trajectory]) -> tuple[Path, ...]:
    """What _save writes."""
    return (path,) if len(people) == 1 else people_paths(path, people)
