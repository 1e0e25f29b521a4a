"""Writing and showing the motion of several people."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from fgpose.io.trajectories import people_paths, save_people
from fgpose.pipeline.people import PeopleResult
from fgpose.pipeline.results import Outputs, show_or_discard, write_all
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
    in files of their own in other formats (see save_people).

    Returns:
        The files; without the .rrd file of a recording that stays open.

    Raises:
        OutputError: a file could not be written, whatever the reason. All others were.
    """
    paths = outputs.trajectory_paths(result.saved).items()
    names = {path: name for path, name in paths if name in result.trajectories}
    time_s = result.association.frames.frame_time_s
    writers: dict[Path | str, Callable[[], object]] = {
        path: partial(save_people, result.trajectories[name], path, outputs.world_up, time_s=time_s)
        for path, name in names.items()
    }
    if viewer is not None:
        writers["the viewer"] = partial(show_or_discard, result, viewer, display)
    elif "rrd" in outputs.formats:
        writers[outputs.path("rrd")] = partial(_write_rrd, result, outputs, display)
    return tuple(
        path
        for written in write_all(writers)
        for path in (people_paths(written, result.trajectories[names[written]]) if written in names else (written,))
    )


def _write_rrd(result: PeopleResult, outputs: Outputs, display: Display) -> None:
    people, rig = result.source.people, result.association.rig
    recording = outputs.open_people_viewer(rig, people.skeleton, len(people.frames.image))
    show_or_discard(result, recording, display)
    recording.close()
