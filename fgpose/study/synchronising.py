"""The step after detection, where cameras were started by hand: when each of them began."""

from __future__ import annotations

import warnings

from fgpose.calibration.from_people.calibrated import Grade
from fgpose.calibration.synchronisation import synchronise
from fgpose.io.calibration import load_calibration_origin, load_rig, save_rig
from fgpose.io.keypoints import load_people
from fgpose.pipeline.origin import synchronised
from fgpose.study.job import SYNCHRONISED, Job
from fgpose.study.recording import Recording
from fgpose.study.study import Study


def synchronises(study: Study, recording: Recording) -> bool:
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
