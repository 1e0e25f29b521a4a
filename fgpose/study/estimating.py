"""The third step: everybody told apart and smoothed. And what is made from their motion."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from fgpose.estimation.smoother import smooth
from fgpose.io.kinematics import save_kinematics
from fgpose.io.origin import Origin, input_file
from fgpose.io.trajectories import load_people_trajectories, save_people, save_trajectory
from fgpose.monocular.flips import correct_flips
from fgpose.monocular.sources import find_clips
from fgpose.pipeline import PeopleSource
from fgpose.pipeline.origin import video_files
from fgpose.report.finished import FinishedRecording, Mark
from fgpose.report.quality import quality
from fgpose.report.report import write_report
from fgpose.report.results import load_finished
from fgpose.study.events import own_events
from fgpose.study.job import ANGLES, MOTION, REPORT, Job
from fgpose.tracking import smooth_people
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
    origin = source.origin and _whole_origin(job, source.origin)
    if isinstance(source, PeopleSource):
        smoothed = smooth_people(source.people, source.rig, config, association=source.association)
        if not smoothed.trajectories:
            raise ValueError(f"{job.recording.source}: {smoothed.association.why_nobody}")
        _save(
            smoothed.trajectories,
            job,
            smoothed.association.frames.frame_time_s,
            origin and replace(origin, events=smoothed.association.events),
        )
        return
    observations = source.observations
    if not observations.n_frames:
        raise ValueError(f"{job.recording.source}: it has no frame")
    if job.recording.kind == "videos":
        observations = correct_flips(observations, source.rig).observations
    trajectory = smooth(observations, source.rig, config)
    if not np.isfinite(trajectory.positions_m).any():
        raise ValueError(f"{job.recording.source}: no joint is determined in any frame; fgpose info says why")
    save_trajectory(trajectory, job.path(MOTION), origin=origin)


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


def _save(people: Mapping[int, Trajectory], job: Job, time_s: np.ndarray, origin: Origin | None) -> None:
    if len(people) == 1:
        (alone,) = people.values()
        save_trajectory(alone, job.path(MOTION), origin=origin)
    else:
        save_people(people, job.path(MOTION), time_s=time_s, origin=origin)


def export(job: Job) -> None:
    """The motion in the formats of other programs. Raises ImportError if a package for one is not installed, OSError if
    a file cannot be written."""
    people = load_people_trajectories(job.path(MOTION))
    for name in job.study.steps.formats:
        path = job.path(MOTION).with_suffix(f".{name}")
        if name in _KINEMATICS:
            save_kinematics(people, path, job.study.steps.world_up)
        elif len(people) == 1:
            (alone,) = people.values()
            save_trajectory(alone, path, job.study.steps.world_up)
        else:
            save_people(people, path, job.study.steps.world_up)


def measure_angles(job: Job) -> None:
    """Joint angles, speeds and heights of everybody. Raises ValueError if the skeleton determines none."""
    save_kinematics(load_people_trajectories(job.path(MOTION)), job.path(ANGLES), job.study.steps.world_up)


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
