"""What is known of the origin of a result while it is made."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from fgpose.calibration.board.calibrate import CalibratedFromBoards
from fgpose.calibration.bumped import BumpedRig
from fgpose.calibration.from_people.calibrated import CalibratedFromPeople, CalibrationFinding, Grade
from fgpose.calibration.self_calibration import CameraCalibration
from fgpose.calibration.synchronisation import Synchronised
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.changing_rig import after, in_pieces, is_changing, put_together
from fgpose.io.calibration import load_calibration_origin
from fgpose.io.origin import CalibrationOrigin, InputFile, MovedCamera, Origin, Reason, input_file, size_bytes
from fgpose.monocular.clips import Clip


def origin_of(rig: CameraRig, fps: float | None = None, **inputs: Path) -> Origin:
    """Files by what they are, and the cameras as they were read, with what the file of the Calibration says of them.

    Raises:
        OSError: a file cannot be seen.
        ValueError: what the calibration says is damaged.
    """
    files = tuple(input_file(what, path) for what, path in inputs.items())
    known = load_calibration_origin(inputs["Calibration"]) if "Calibration" in inputs else CalibrationOrigin()
    return Origin(files, rig, known.subset(rig.names), fps=fps, fgpose=version("fgpose"))


def video_files(clips: Sequence[Clip]) -> tuple[InputFile, ...]:
    """Of each camera. Raises OSError if a file cannot be seen."""
    return tuple(
        replace(input_file("Video", clip.path), camera=clip.name, image_px=clip.size_px, rate_hz=clip.fps)
        for clip in clips
    )


def warn_of_other_videos(origin: Origin | None, clips: Sequence[Clip]) -> None:
    """Warn (UserWarning) where the videos of cameras are of another size than those that a result was made from.
    Raises OSError if one cannot be seen."""
    known = {} if origin is None else {each.camera: each for each in origin.inputs if each.what == "Video"}
    made_from = [(clip, known[clip.name]) for clip in clips if clip.name in known]
    others = [str(clip.path) for clip, file in made_from if size_bytes(clip.path) != file.size_bytes]
    if others:
        which = f"{others[0]} is not the file" + (f", and {len(others) - 1} more are not those," if others[1:] else "")
        warnings.warn(f"{which} that the result was made from: is it of the same recording?", stacklevel=2)


def recalibrated(origin: Origin, before: CameraRig, found: CameraCalibration[Any]) -> Origin:
    """After the cameras were calibrated on the recording.

    Args:
        origin: before.
        before: the cameras with which it was calibrated. Their offsets are zero where the images were put together by
            those of the origin, which then remain.
        found: what was found.
    """
    changed = found.changed
    rig = put_together(changed or before, found.rig, before if changed is None else in_pieces(changed))
    if origin.rig is not None:
        given = origin.rig.subset(name for name in origin.rig.names if name in rig.names)
        put_on_clock = is_changing(given) or bool((given.time_offsets_s != before.time_offsets_s).any())
        rig = after(given, rig) if put_on_clock else rig
    known, estimated = origin.calibration.subset(rig.names), set(origin.estimated)
    if found.time_offsets is not None:
        estimated.add("clocks")
        known = replace(known, offset_sigma_s=_known(found.rig, found.time_offsets.sigma_s))
    if found.refinement is not None:
        estimated.add("poses")
        refined = found.refinement
        numbers = (
            refined.rotation_deg,
            refined.translation_m,
            refined.rotation_sigma_deg,
            refined.translation_sigma_m,
        )
        rows = zip(found.rig.names, *(each.tolist() for each in numbers), strict=True)
        moved = tuple(MovedCamera(*row) for row in rows)
        known = replace(known, moved=moved, shift_sigma_m=refined.shift_sigma_m)
    return replace(origin, rig=rig, calibration=known, estimated=tuple(sorted(estimated)))


def synchronised(known: CalibrationOrigin, found: Synchronised) -> CalibrationOrigin:
    """After it was found when the cameras of a rig began. What is said of those that were left out remains."""
    sigma_s = _known(found.rig, found.sigma_s)
    return replace(known, offset_sigma_s=sigma_s, findings=(*known.findings, *reasons(found.findings)))


def from_people(origin: Origin, found: CalibratedFromPeople) -> Origin:
    """After the cameras were calibrated from people."""
    return replace(origin, rig=found.rig, calibration=calibration_from_people(found))


def calibration_from_people(found: CalibratedFromPeople) -> CalibrationOrigin:
    """Of the rig that was found."""
    sigma_s = _known(found.rig, found.sigmas.offset_s)
    return CalibrationOrigin(sigma_s, grade=found.grade.value, findings=reasons(found.findings), method="from people")


def calibration_from_boards(found: CalibratedFromBoards) -> CalibrationOrigin:
    """Of the rig that was found."""
    covered = zip(found.rig.names, found.sightings.coverage.tolist(), strict=True)
    return CalibrationOrigin(
        grade=found.grade.value,
        findings=reasons(found.findings),
        method="with a board",
        coverage={name: tuple(map(tuple, counts)) for name, counts in covered},
    )


def after_bumps(known: CalibrationOrigin, found: BumpedRig[Any]) -> CalibrationOrigin:
    """After the cameras that were bumped have got new poses: what was found of the rig before comes first, the grade is
    the worst of both."""
    known = known.subset(found.rig.names)
    rows = zip(found.rig.names, found.moved.tolist(), found.rotation_deg, found.translation_m, strict=True)
    # A rig that was given, and about which nothing was found, has no verdict.
    grades = ["", *(grade.value for grade in Grade)]
    own = found.grade.value if found.findings else ""
    return replace(
        known,
        moved=tuple(MovedCamera(name, float(deg), float(m)) for name, has_moved, deg, m in rows if has_moved),
        grade=max(known.grade, own, key=grades.index),
        findings=(*known.findings, *reasons(found.findings)),
    )


def reasons(findings: Sequence[CalibrationFinding]) -> tuple[Reason, ...]:
    """As files say them."""
    return tuple(Reason(each.camera, each.grade.value, each.reason, each.remedy) for each in findings)


def _known(rig: CameraRig, sigma_s: np.ndarray) -> dict[str, float]:
    pairs = zip(rig.names, sigma_s.tolist(), strict=True)
    # Zero is that of an offset that was given.
    return {name: each_s for name, each_s in pairs if np.isfinite(each_s) and each_s > 0}
