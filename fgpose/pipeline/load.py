"""Reading a recording."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, TypedDict, Unpack

from fgpose.association.chosen_person import PersonRegion
from fgpose.association.common_clock import on_common_clock
from fgpose.geometry.camera import CameraRig
from fgpose.io.calibration import Unit, load_rig
from fgpose.io.camera_names import counted_otherwise, seen_cameras
from fgpose.io.keypoints import keypoint_cameras, load_people
from fgpose.observations import Observations, check_confidence
from fgpose.people import PeopleObservations
from fgpose.pipeline.detected_orientation import as_detected
from fgpose.pipeline.origin import origin_of
from fgpose.pipeline.source import Source
from fgpose.skeleton import Skeleton


class Reading(TypedDict, total=False):
    """How keypoints and calibration are read, see load_rig and load_people."""

    fps: float | None
    unit: Unit
    points3d_frame: Literal["camera", "world"]
    points3d_unit: Literal["mm", "m"]
    min_confidence: float
    """Detections below it are taken for missing."""


def load_source(
    keypoints: Path,
    calibration: Path,
    skeleton: str | Path | Skeleton,
    *,
    cameras: tuple[str, ...] = (),
    person: int | PersonRegion = 0,
    **reading: Unpack[Reading],
) -> Source[Observations]:
    """Read what the cameras saw of one person, see load_people_source; all cameras tell who that is.

    Args:
        person: 0 for the main one, 1 for the next, ...; or the one in a region (chosen_person).

    Raises:
        ValueError, OSError: as load_people_source; or there is no such person.
    """
    everybody = _everybody(keypoints, calibration, skeleton, cameras, reading)
    try:
        one = everybody.one(person)
    except ValueError as error:
        raise ValueError(f"{keypoints}: {error}") from None
    return one.subset(cameras)


def load_people_source(
    keypoints: Path,
    calibration: Path,
    skeleton: str | Path | Skeleton,
    *,
    cameras: tuple[str, ...] = (),
    **reading: Unpack[Reading],
) -> Source[PeopleObservations]:
    """Read a recording of everybody: load_rig and load_people, which say what is read and what each argument means.
    Where the cameras began at different moments (on_common_clock), its times are those of the rig.

    Args:
        keypoints: folder or file of the detected joints.
        calibration: file of the cameras.
        skeleton: what the keypoints are.
        cameras: use only these, in this order. Calibration and keypoints may then have cameras that the other lacks.
        reading: how both are read.

    Raises:
        ValueError: something is wrong with a file, a camera is unknown, or the cameras that are wanted seem to have
            other numbers in the keypoints; the message names it.
        OSError: a file cannot be read.

    Warns:
        UserWarning: as load_people.
    """
    return _everybody(keypoints, calibration, skeleton, cameras, reading).subset(cameras)


def _everybody(
    keypoints: Path,
    calibration: Path,
    skeleton: str | Path | Skeleton,
    cameras: tuple[str, ...],
    reading: Reading,
) -> Source[PeopleObservations]:
    """In all cameras that saw something."""
    least = reading.get("min_confidence", 0.0)
    check_confidence(least)
    rig = _rig(keypoints, calibration, reading.get("unit", "auto"), cameras)
    given: dict[str, Any] = {name: each for name, each in reading.items() if name not in ("unit", "min_confidence")}

    def seen_by(rig: CameraRig) -> PeopleObservations:
        return load_people(keypoints, rig, skeleton, ignore_other_cameras=bool(cameras), **given)

    rig = as_detected(rig, calibration, lambda each: Source(each, seen_by(each)).one().observations)
    origin = origin_of(rig, reading.get("fps"), Keypoints=keypoints, Calibration=calibration)
    people, rig = on_common_clock(seen_by(rig).confident(least), rig)
    return Source(rig, people, replace(origin, remarks=people.remarks))


def _rig(keypoints: Path, calibration: Path, unit: Unit, cameras: tuple[str, ...]) -> CameraRig:
    """The cameras wanted, and all others that saw something: together they tell best who is who."""
    rig = load_rig(calibration, unit)
    if not cameras:
        return rig
    rig.subset(cameras)
    theirs = keypoint_cameras(keypoints)
    if said := counted_otherwise(theirs, rig.names):
        raise ValueError(f"{keypoints}: {said}. If not, take the cameras that are not wanted out of both")
    seen = seen_cameras(theirs, rig.names)
    return rig.subset(name for name in rig.names if name in seen or name in cameras)
