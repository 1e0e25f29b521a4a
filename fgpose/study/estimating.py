"""The third step: everybody told apart and smoothed. And what is made from their motion."""

from __future__ import annotations

import shlex
from dataclasses import replace

from fgpose.diagnosis.finished import FinishedRecording, Mark
from fgpose.geometry.up_axis import WorldUp
from fgpose.io.kinematics import save_kinematics
from fgpose.io.origin import Origin, input_file
from fgpose.io.trajectories import load_origin, load_people_trajectories, save_people
from fgpose.io.upright import resolved_up
from fgpose.monocular.flips import correct_flips
from fgpose.monocular.sources import find_clips
from fgpose.observations import Observations
from fgpose.pipeline import AnySource, run_smooth
from fgpose.pipeline.diagnosed import diagnosed
from fgpose.pipeline.origin import video_files
from fgpose.report.quality import quality
from fgpose.report.report import write_report
from fgpose.report.results import load_finished
from fgpose.study.events import own_events
from fgpose.study.job import ANGLES, MOTION, REPORT, Job
from fgpose.trajectory import Trajectory

# Of these C3D also holds the points.
_KINEMATICS = ("mot", "bvh", "c3d")


_AS_RECORDED, _AS_GIVEN = "Keypoints as recorded", "Calibration as given"
"""Inputs in whose place those of an earlier step were used."""


def estimate(job: Job) -> None:
    """Who is who, and the motion of each.

    Raises:
        ValueError: the recording cannot be read, or nobody is found in it.
        OSError: a file cannot be read or written.
    """
    source, config = job.source(), job.study.parameters
    source = replace(source, origin=source.origin and _whole_origin(job, source.origin))
    try:
        result = diagnosed(run_smooth(_corrected(job, source), config, compare=False), job.study.steps.world_up)
        save_people(result.main, job.path(MOTION), time_s=result.frame_time_s, origin=result.origin)
    except ValueError as error:
        raise ValueError(f"{job.recording.source}: {error}") from None


def _corrected(job: Job, source: AnySource) -> AnySource:
    """Left and right of one person whom a network has seen; of several it is told with who is who."""
    seen = source.observations
    if not seen.n_frames:
        raise ValueError("it has no frame")
    if job.recording.kind == "videos" and isinstance(seen, Observations):
        return replace(source, observations=correct_flips(seen, source.rig).observations)
    return source


def _whole_origin(job: Job, origin: Origin) -> Origin:
    """With what earlier steps began from."""
    recording, study = job.recording, job.study
    origin = replace(origin, command=shlex.join(["fgpose", "study", study.file_name, "--only", recording.key]))
    if recording.kind == "videos":
        names = () if origin.rig is None else origin.rig.names
        clips = find_clips(recording.source, fps=study.data.fps, cameras=names)
        origin = origin.with_inputs(input_file("Videos", recording.source), *video_files(clips))
    elif job.keypoints != recording.source:
        origin = origin.with_inputs(input_file(_AS_RECORDED, recording.source))
    if recording.calibration is not None and job.calibration != recording.calibration:
        origin = origin.with_inputs(input_file(_AS_GIVEN, recording.calibration))
    if study.from_people.intrinsics and study.steps.calibrate == "people":
        origin = origin.with_inputs(input_file("Intrinsics", study.file(study.from_people.intrinsics)))
    return origin


def export(job: Job) -> None:
    """The motion in the formats of other programs. Raises ImportError if a package for one is not installed, OSError if
    a file cannot be written."""
    people, world_up = _with_up(job)
    for name in job.study.steps.formats:
        path = job.path(MOTION).with_suffix(f".{name}")
        if name in _KINEMATICS:
            save_kinematics(people, path, world_up)
        else:
            save_people(people, path, world_up)


def measure_angles(job: Job) -> None:
    """Joint angles, speeds and heights of everybody. Raises ValueError if the skeleton determines none."""
    people, world_up = _with_up(job)
    save_kinematics(people, job.path(ANGLES), world_up)


def _with_up(job: Job) -> tuple[dict[int, Trajectory], WorldUp]:
    """Everybody, and what is up in their world."""
    path = job.path(MOTION)
    people, origin = load_people_trajectories(path), load_origin(path)
    return people, resolved_up(people.values(), job.study.steps.world_up, path, origin and origin.rig)


def judge(job: Job) -> None:
    """The row of the recording in the table of quality."""
    found = quality(_finished(job))
    numbers = {name: value for name, value in found.numbers.items() if name != "name"}
    job.row.update(numbers, suspicions="; ".join(each.reason for each in found.suspicions))


def report(job: Job) -> None:
    """The page of the recording."""
    marks = tuple(Mark(time_s, name) for time_s, name in own_events(job.study, job.recording))
    write_report(replace(_finished(job), marks=marks), job.path(REPORT))


def _finished(job: Job) -> FinishedRecording:
    return load_finished(job.path(MOTION), title=job.recording.key, world_up=job.study.steps.world_up)
