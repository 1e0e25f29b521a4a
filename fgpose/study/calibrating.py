"""The second step: the cameras, refined on the recording or found from the people in it."""

from __future__ import annotations

from collections.abc import Sequence

from fgpose.calibration.from_people.calibrate import Focal, calibrate, unknown_focal
from fgpose.calibration.from_people.calibrated import CalibratedFromPeople, Finding, Grade
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.intrinsics import guessed_intrinsics
from fgpose.io.calibration import load_intrinsics, save_rig
from fgpose.io.keypoints import (
    check_sizes,
    likely_sizes_px,
    load_uncalibrated,
    save_observations,
    save_people_observations,
)
from fgpose.people import PeopleObservations
from fgpose.pipeline import run_calibrate
from fgpose.pipeline.origin import calibration_from_people
from fgpose.study.job import CALIBRATION, SEEN, Job
from fgpose.study.study import Study


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
    save_rig(after.rig, job.path(CALIBRATION), origin=after.origin and after.origin.calibration)


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


def intrinsics_of(study: Study, names: Sequence[str], sizes_px: Sequence[tuple[int, int]]) -> CameraRig:
    """Of the cameras with these names, as given or guessed. Raises ValueError if the file lacks one, OSError if it
    cannot be read."""
    if study.from_people.intrinsics:
        return load_intrinsics(study.file(study.from_people.intrinsics), names, sizes_px)
    return guessed_intrinsics(names, sizes_px, None)


def from_people(study: Study, people: PeopleObservations, intrinsics: CameraRig) -> CalibratedFromPeople:
    """Cameras calibrated from people. Raises ValueError, with the reasons, if that has failed."""
    known = study.from_people
    focal: Focal = "known" if known.intrinsics else unknown_focal(intrinsics)
    result = calibrate(people, intrinsics, focal=focal, stature_m=known.stature_m, synchronised=known.synchronised)
    if result.grade is Grade.FAILED:
        reasons = "; ".join(_reason(finding) for finding in result.findings if finding.grade is Grade.FAILED)
        raise ValueError(f"the calibration from people has failed: {reasons}")
    return result


def _reason(finding: Finding) -> str:
    return f"{finding.camera}: {finding.reason}" if finding.camera else finding.reason
