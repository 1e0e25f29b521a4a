"""The steps of the chain: each reads files of a recording at work and writes others."""

from __future__ import annotations

import os
import shlex
import warnings
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fgpose.calibration.from_people.calibrate import Focal, calibrate_from_people, unknown_focal
from fgpose.calibration.from_people.calibrated import CalibratedFromPeople, CalibrationFinding, Grade
from fgpose.calibration.synchronisation import synchronise
from fgpose.diagnosis.finished import FinishedRecording, Mark
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.intrinsics import guessed_intrinsics
from fgpose.geometry.up_axis import WorldUp
from fgpose.io.calibration import CalibrationOrigin, load_calibration_origin, load_intrinsics, load_rig, save_rig
from fgpose.io.keypoints import (
    check_sizes,
    likely_sizes_px,
    load_people,
    load_uncalibrated,
    save_observations,
    save_people_observations,
)
from fgpose.io.origin import Origin, input_file
from fgpose.io.trajectories import load_origin, load_people_trajectories, save_people
from fgpose.io.trajectories.kinematics import save_kinematics
from fgpose.io.trajectories.upright import resolved_up
from fgpose.monocular.detected import Detected
from fgpose.monocular.detection import detect as run_network
from fgpose.monocular.downloads.cache import cache_folder
from fgpose.monocular.sources import Sources, find_clips, open_sources
from fgpose.people_observations import PeopleObservations
from fgpose.pipeline import run_calibrate, run_smooth
from fgpose.pipeline.diagnosed import diagnosed
from fgpose.pipeline.origin import calibration_from_people, synchronised, video_files
from fgpose.report.quality import quality
from fgpose.report.report import write_report
from fgpose.report.results import load_finished
from fgpose.study.events import own_events
from fgpose.study.job import ANGLES, CALIBRATION, CAMERAS, DETECTED, MOTION, REPORT, SEEN, SYNCHRONISED, Job, network
from fgpose.study.study import StudyDescription
from fgpose.study.trial import Trial
from fgpose.trajectory import Trajectory

# Of these C3D also holds the points.
_KINEMATICS = ("mot", "bvh", "c3d")
_AS_RECORDED, _AS_GIVEN = "Keypoints as recorded", "Calibration as given"
"""Inputs in whose place those of an earlier step were used."""


def detect(job: Job) -> None:
    """Find the people in all images. Where the cameras are to be calibrated from people, they are so at once: the 3D of
    each view depends on the focal length.

    Raises:
        ValueError: the videos do not fit the calibration, are damaged, or nobody is found; the calibration has failed.
        OSError: a video cannot be read, or the weights cannot be fetched.
    """
    # FFmpeg says on stderr of every process what the error says too.
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    os.environ.setdefault("OPENCV_LOG_LEVEL", "ERROR")
    if job.recording.calibration is None:
        detected, known = _calibrated(job)
    else:
        known = load_calibration_origin(job.recording.calibration)
        detected = _detected(job, _with_rig(job))
    save_people_observations(detected.people, job.path(DETECTED))
    save_rig(detected.rig, job.path(CAMERAS), origin=known.subset(detected.rig.names))


def _with_rig(job: Job) -> Sources:
    data = job.study.data
    assert job.recording.calibration is not None
    rig = load_rig(job.recording.calibration, job.reading["unit"])
    if synchronises(job.study, job.recording):
        rig = rig.with_time_offsets(np.zeros(rig.n_cameras))  # those of the trial that they were calibrated on
    return open_sources(job.recording.source, rig, fps=data.fps, cameras=data.cameras)


def _detected(job: Job, sources: Sources) -> Detected:
    # One thread: the other cores have recordings of their own.
    return run_network(sources, network(job.study), cache=cache_folder() / "detections", jobs=1)


def _calibrated(job: Job) -> tuple[Detected, CalibrationOrigin]:
    data = job.study.data
    clips = find_clips(job.recording.source, fps=data.fps, cameras=data.cameras)
    rig = intrinsics_of(job.study, [clip.name for clip in clips], [clip.size_px for clip in clips])
    detected = _detected(job, Sources(rig, clips))
    found = from_people(job.study, detected.people, rig)
    return detected.recalibrated(found.rig), calibration_from_people(found)


def synchronises(study: StudyDescription, recording: Trial) -> bool:
    """Whether a recording needs starts of its own."""
    if study.steps.calibrate == "people":
        # Where the cameras are calibrated, their starts are found too.
        return bool(recording.calibrated_on) and not study.from_people.synchronised
    return study.steps.synchronise


def find_starts(job: Job) -> None:
    """Find when each camera began. One for which it is not found is left out of the recording, with a warning.

    Raises:
        ValueError: the keypoints cannot be read, or fewer than two starts are found, with the reasons.
        OSError: a file cannot be read or written.
    """
    data, file = job.study.data, job.calibration
    rig, known = load_rig(file, job.reading["unit"]), load_calibration_origin(file)
    rig = rig.subset(data.cameras) if data.cameras else rig
    people = load_people(
        job.keypoints,
        rig,
        job.skeleton,
        fps=data.fps,
        points3d_frame=job.reading["points3d_frame"],
        points3d_unit=data.points3d_unit,
        ignore_other_cameras=bool(data.cameras),
    )
    found = synchronise(people, rig)
    for each in found.findings:
        if each.grade is Grade.FAILED:
            warnings.warn(f"camera {each.camera} is left out: {each.reason}", stacklevel=2)
    save_rig(found.rig, job.path(SYNCHRONISED), origin=synchronised(known.subset(found.rig.names), found))


def recalibrate(job: Job) -> None:
    """Calibrate the cameras as the study says.

    Raises:
        ValueError: the keypoints cannot be read, or the calibration has failed, with the reasons.
        OSError: a file cannot be read or written.
    """
    if job.study.steps.calibrate == "people":
        result = _from_keypoints(job)
        save_rig(result.rig, job.path(CALIBRATION), origin=calibration_from_people(result))
        return
    source, config = job.source(), job.study.parameters
    wanted = {
        "poses": job.study.steps.calibrate != "refine-clocks",
        "clocks": job.study.steps.calibrate != "refine-poses",
    }
    after, _ = run_calibrate(source, config, **wanted)
    if isinstance(after.observations, PeopleObservations):
        save_people_observations(after.observations, job.path(SEEN))
    else:
        save_observations(after.observations, job.path(SEEN))
    save_rig(after.rig, job.path(CALIBRATION), origin=None if after.origin is None else after.origin.calibration)


def _from_keypoints(job: Job) -> CalibratedFromPeople:
    data = job.study.data
    people = load_uncalibrated(
        job.recording.source, job.skeleton, fps=data.fps, points3d_unit=data.points3d_unit, cameras=data.cameras
    )
    if not any(image.n_people for image in people.images):
        raise ValueError(f"{job.recording.source}: the keypoints have no joint in any camera")
    names = people.camera_names
    file = job.study.from_people.intrinsics
    known = load_intrinsics(job.study.file(file), names).cameras if file else ()
    sizes_px = [camera.size_px for camera in known] or likely_sizes_px(people)
    intrinsics = intrinsics_of(job.study, names, sizes_px)
    check_sizes(people, intrinsics)
    return from_people(job.study, people, intrinsics)


def intrinsics_of(study: StudyDescription, names: Sequence[str], sizes_px: Sequence[tuple[int, int]]) -> CameraRig:
    """Of the cameras with these names, as given or guessed. Raises ValueError if the file lacks one, OSError if it
    cannot be read."""
    if study.from_people.intrinsics:
        return load_intrinsics(study.file(study.from_people.intrinsics), names, sizes_px)
    return guessed_intrinsics(names, sizes_px, None)


def from_people(study: StudyDescription, people: PeopleObservations, intrinsics: CameraRig) -> CalibratedFromPeople:
    """Cameras calibrated from people. Raises ValueError, with the reasons, if that has failed."""
    known = study.from_people
    focal: Focal = "known" if known.intrinsics else unknown_focal(intrinsics)
    result = calibrate_from_people(
        people, intrinsics, focal=focal, stature_m=known.stature_m, synchronised=known.synchronised
    )
    if result.grade is Grade.FAILED:
        reasons = "; ".join(_reason(finding) for finding in result.findings if finding.grade is Grade.FAILED)
        raise ValueError(f"the calibration from people has failed: {reasons}")
    return result


def _reason(finding: CalibrationFinding) -> str:
    return f"{finding.camera}: {finding.reason}" if finding.camera else finding.reason


def estimate(job: Job) -> None:
    """Who is who, and the motion of each.

    Raises:
        ValueError: the recording cannot be read, or nobody is found in it.
        OSError: a file cannot be read or written.
    """
    source, config = job.source(), job.study.parameters
    source = replace(source, origin=source.origin and _whole_origin(job, source.origin))
    try:
        if not source.observations.n_frames:
            raise ValueError("it has no frame")
        # The axis that is up is judged with the result (judge, report): a motion does not depend on it.
        result = diagnosed(run_smooth(source, config, compare=False))
        save_people(result.main, job.path(MOTION), time_s=result.frame_time_s, origin=result.origin)
    except ValueError as error:
        raise ValueError(f"{job.recording.source}: {error}") from None


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
    return people, resolved_up(people.values(), job.study.steps.world_up, path, None if origin is None else origin.rig)


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
