"""The report on a recording, with what to do about it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from rich.console import Console
from rich.table import Table

from fgpose.assessment.recording_info import CameraInfo, RecordingInfo
from fgpose.calibration.camera_faults import CameraFault
from fgpose.cli.tables import new_table

# More would hide the rest of the report.
_MAX_GAPS = 10
# Higher, cameras are named that only have the person partly hidden; lower, some of little use are not.
_FEW_SEEN = 0.5
# More than clocks differ that were ever set alike, and half of what --estimate-time-offsets finds.
_FAR_APART_S = 0.12


def print_info(console: Console, info: RecordingInfo, faults: tuple[CameraFault, ...]) -> None:
    """The tables, then the hints."""
    rate = "" if np.isnan(info.fps) else f" at {info.fps:.4g} Hz"
    views = "2D and per-view 3D" if info.has_points3d else "2D only"
    console.print(
        f"{info.n_frames} frames{rate} ({info.duration_s:.4g} s), {len(info.cameras)} cameras, "
        f"{info.n_joints} joints ({info.skeleton}), {views}"
    )
    console.print(_seen_table(info))
    console.print(_check_table(info.cameras))
    if faults:
        console.print(_faults_table(faults, info.fps))
    for gap in info.gaps[:_MAX_GAPS]:
        console.print(
            f"gap: {gap.joint} seen by fewer than two cameras for {gap.duration_s:.2f} s from {gap.start_s:.2f} s"
        )
    if len(info.gaps) > _MAX_GAPS:
        console.print(f"gap: {len(info.gaps) - _MAX_GAPS} shorter ones")
    remarks = [*hints(info), *fault_hints(faults)]
    for remark in remarks:
        console.print(f"! {remark}")
    if not info.suspicious and not any(fault.late or fault.moved for fault in faults):
        console.print("Nothing is clearly wrong." if remarks else "Nothing suspicious.")


def hints(info: RecordingInfo) -> Iterator[str]:
    """What is probably wrong, and what to do about it."""
    for remark in info.implausible:
        yield f"Implausible: {remark}. Millimetres taken for metres, or the reverse? See --unit and --points3d-unit."
    if info.suspected_calibration:
        yield (
            f"The calibration of {info.suspected_calibration} is probably wrong: the other cameras agree without it "
            "and miss it by far. Has it been moved, or are two cameras exchanged? Calibrate it again, or leave it out "
            "with --cameras. Time offsets and small errors of the calibration can only be estimated after that."
        )
    for name in info.suspected_swaps:
        (camera,) = (camera for camera in info.cameras if camera.name == name)
        yield f"{name} exchanges left and right in {100 * camera.share_swapped:.0f} % of the pairs that can be judged."
    for camera in info.cameras:
        if camera.share_seen < _FEW_SEEN:
            yield f"{camera.name} sees only {100 * camera.share_seen:.0f} % of the joints."
    if info.never_seen:
        yield f"Never seen by two cameras at once, so not estimated: {', '.join(info.never_seen)}."
    if len(info.cameras) < 3:
        yield "With fewer than three cameras nothing can be said about calibration and time."


def fault_hints(faults: tuple[CameraFault, ...]) -> Iterator[str]:
    """Cameras that are late or were moved, and the options that correct it."""
    late, moved = [fault for fault in faults if fault.late], [fault for fault in faults if fault.moved]
    # While the person walks in one direction, both faults cause the same errors. Either option alone would absorb the
    # error of the other.
    both = " and --refine-calibration together" if moved else ""
    for fault in late:
        ms, sigma_ms = 1000 * abs(fault.offset_s), 1000 * fault.offset_sigma_s
        yield (
            f"{fault.name} takes its images {abs(fault.offset_frames):.1f} frames ({ms:.0f} +/- {sigma_ms:.0f} ms) "
            f"{'later' if fault.offset_s > 0 else 'earlier'} than their times say, measured by the clocks of the "
            f"others. Use --estimate-time-offsets{both}."
        )
    if any(abs(fault.offset_s) > _FAR_APART_S for fault in late):
        yield "Were the cameras started by hand? Then fgpose synchronise finds when each began, however far apart."
    together = " and --estimate-time-offsets together" if late else ""
    for fault in sorted(moved, key=lambda fault: -fault.rotation_deg):
        yield (
            f"{fault.name} seems to have been moved since it was calibrated, by about {fault.rotation_deg:.1f} degrees "
            f"and {100 * fault.translation_m:.0f} cm; a wrong principal point or image size looks the same. "
            f"Use --refine-calibration{together}."
        )


def _seen_table(info: RecordingInfo) -> Table:
    """What each camera sees, and how many cameras see a joint at a time."""
    table = new_table("camera", "joints seen", "confidence", "distance [m]")
    for camera in info.cameras:
        seen = f"{100 * camera.share_seen:.0f} %"
        table.add_row(camera.name, seen, _number(camera.confidence, ".2f"), _number(camera.distance_m, ".2f"))
    table.add_section()
    total = sum(info.joint_frames_by_views)
    for views, count in enumerate(info.joint_frames_by_views):
        label = f"in {views or 'no'} camera{'' if views == 1 else 's'}"
        table.add_row(label, f"{100 * count / total:.1f} %")
    return table


def _check_table(cameras: tuple[CameraInfo, ...]) -> Table:
    """How well each camera agrees with the others."""
    table = new_table("camera", "error\n[px]", "90 %\n[px]", "left out\n[px]", "constant\n[px]", "swapped\n[%]")
    table.caption = (
        "error: distance to the triangulation of all cameras (median, 90 % quantile). left out: distance to that of "
        "the other cameras only. constant: the constant part of it. swapped: left and right exchanged."
    )
    table.caption_justify = "left"
    for camera in cameras:
        errors_px = camera.residual_px, camera.residual_q90_px, camera.left_out_px, camera.constant_px
        table.add_row(
            camera.name,
            *(_number(error_px, ".1f") for error_px in errors_px),
            _number(100 * camera.share_swapped, ".1f"),
        )
    return table


def _faults_table(faults: tuple[CameraFault, ...], fps: float) -> Table:
    """What would make the cameras agree."""
    table = new_table("camera", "taken later\n[ms]", "taken later\n[frames]", "turned\n[deg]", "moved\n[cm]")
    table.caption = (
        "taken later: how much later than their times the images were taken (negative: earlier), relative to the "
        "camera whose clock is nearest to all others. turned, moved: the change of pose that would make the cameras "
        "agree. All estimated on 20 s at most."
    )
    table.caption_justify = "left"
    for fault in faults:
        table.add_row(
            fault.name,
            _plus_minus(1000 * fault.offset_s, 1000 * fault.offset_sigma_s, 0),
            _plus_minus(fault.offset_frames, fps * fault.offset_sigma_s, 2),
            f"{fault.rotation_deg:.2f}",
            f"{100 * fault.translation_m:.1f}",
        )
    return table


def _plus_minus(value: float, sigma: float, digits: int) -> str:
    """A number with its sign and its standard deviation, if it has one; in ASCII, for any terminal."""
    return f"{value:+.{digits}f} +/- {sigma:.{digits}f}" if sigma else f"{value:.{digits}f}"


def _number(value: float, form: str) -> str:
    return "-" if np.isnan(value) else format(value, form)
