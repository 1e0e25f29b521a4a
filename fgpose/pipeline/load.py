"""Reading a recording."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, TypedDict, Unpack

from fgpose.association.chosen_person import PersonRegion
from fgpose.association.common_clock import on_common_clock
from fgpose.freed_memory import hand_back
from fgpose.geometry.camera import CameraRig
from fgpose.io.calibration import Unit, load_rig
from fgpose.io.keypoints import keypoint_cameras, load_recording
from fgpose.io.keypoints.stated_skeleton import stated_skeleton
from fgpose.io.names import counted_otherwise, seen_cameras
from fgpose.observations import check_confidence
from fgpose.pipeline.detected_orientation import as_detected
from fgpose.pipeline.origin import origin_of
from fgpose.pipeline.source import AnySource, Source
from fgpose.plain_files import naming
from fgpose.skeleton import Skeleton


class Reading(TypedDict, total=False):
    """How keypoints and calibration are read, see load_rig and load_people."""

    fps: float | None
    unit: Unit
    points3d_frame: Literal["camera", "world"]
    points3d_unit: Literal["mm", "m"]
    min_confidence: float
    """Detections below it are taken for missing."""


Wanted = Literal["auto", "all", "1"] | PersonRegion
"""Everybody, the main person, or the one in a region; auto: as many as there are, see Source.one_or_all."""


def load_source(
    keypoints: Path,
    calibration: Path,
    skeleton: str | Path | Skeleton | None = None,
    *,
    cameras: tuple[str, ...] = (),
    people: Wanted = "auto",
    n_frames: int | None = None,
    **reading: Unpack[Reading],
) -> AnySource:
    """Read a recording: load_rig and load_people, which say what is read and what each argument means. Where the
    cameras began at different moments (on_common_clock), its times are those of the rig.

    Args:
        keypoints: folder or file of the detected joints.
        calibration: file of the cameras.
        skeleton: what the keypoints are; None: as they say.
        cameras: use only these, in this order. Calibration and keypoints may then have cameras that the other lacks;
            all together tell who is the one who is wanted.
        people: who is wanted.
        n_frames: use only so many, from the beginning.
        reading: how both are read.

    Raises:
        ValueError: something is wrong with a file, a camera is unknown, there is nobody in the region, or the cameras
            that are wanted seem to have other numbers in the keypoints; the message names it.
        OSError: a file cannot be read.

    Warns:
        UserWarning: as load_people.
    """
    if skeleton is None:
        skeleton = stated_skeleton(keypoints)
    wanted = _wanted(
        _recording(keypoints, calibration, skeleton, cameras, reading), keypoints, cameras, people, n_frames
    )
    hand_back()
    return wanted


def _wanted(
    recording: AnySource,
    keypoints: Path,
    cameras: tuple[str, ...],
    people: Wanted,
    n_frames: int | None,
) -> AnySource:
    if people == "auto":
        return recording.subset(cameras).first_frames(n_frames).one_or_all()
    everybody = recording.everybody()
    if people == "all":
        return everybody.subset(cameras).first_frames(n_frames)
    with naming(keypoints):
        one = everybody.one(people if isinstance(people, PersonRegion) else 0)
    return one.subset(cameras).first_frames(n_frames)


def _recording(
    keypoints: Path,
    calibration: Path,
    skeleton: str | Path | Skeleton,
    cameras: tuple[str, ...],
    reading: Reading,
) -> AnySource:
    """In all cameras that saw something."""
    least = reading.get("min_confidence", 0.0)
    check_confidence(least)
    rig = _rig(keypoints, calibration, reading.get("unit", "auto"), cameras)
    given: dict[str, Any] = {name: each for name, each in reading.items() if name not in ("unit", "min_confidence")}

    def seen_by(rig: CameraRig) -> Any:  # of one person or of everybody
        return load_recording(keypoints, rig, skeleton, ignore_other_cameras=bool(cameras), **given)

    rig = as_detected(rig, calibration, lambda each: Source(each, seen_by(each)).one().observations)
    origin = origin_of(rig, reading.get("fps"), Keypoints=keypoints, Calibration=calibration)
    seen, rig = on_common_clock(seen_by(rig).confident(least), rig)
    return Source(rig, seen, replace(origin, remarks=seen.remarks))


def _rig(keypoints: Path, calibration: Path, unit: Unit, cameras: tuple[str, ...]) -> CameraRig:
    """The cameras wanted, and all others that saw something: together they tell best who is who."""
    rig = load_rig(calibration, unit)
    if not cameras:
        return rig
    with naming(calibration):
        rig.subset(cameras)
    theirs = keypoint_cameras(keypoints)
    if said := counted_otherwise(theirs, rig.names):
        raise ValueError(f"{keypoints}: {said}. If not, take the cameras that are not wanted out of both")
    seen = seen_cameras(theirs, rig.names)
    return rig.subset(name for name in rig.names if name in seen or name in cameras)
