"""The first step: a network looks at the videos."""

from __future__ import annotations

import os

import numpy as np

from fgpose.io.calibration import CalibrationOrigin, load_calibration_origin, load_rig, save_rig
from fgpose.io.keypoints import save_people_observations
from fgpose.monocular.cache import cache_folder
from fgpose.monocular.detected import Detected
from fgpose.monocular.detection import detect as run_network
from fgpose.monocular.sources import Sources, find_clips, open_sources
from fgpose.pipeline.origin import calibration_from_people
from fgpose.study.calibrating import from_people, intrinsics_of
from fgpose.study.job import CAMERAS, DETECTED, Job
from fgpose.study.networks import network
from fgpose.study.synchronising import synchronises


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
