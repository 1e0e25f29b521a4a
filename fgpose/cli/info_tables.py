"""The report on a recording, with what to do about it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from rich.console import Console
from rich.table import Table

from fgpose.cli.tables import new_table
from fgpose.info import CameraInfo, RecordingInfo

_MAX_GAPS = 10
_FEW_SEEN = 0.5


def print_info(console: Console, info: RecordingInfo) -> None:
    """The tables, then the hints."""
    rate = "" if np.isnan(info.fps) else f" at {info.fps:.4g} Hz"
    views = "2D and per-view 3D" if info.has_points3d else "2D only"
    console.print(
        f"{info.n_frames} frames{rate} ({info.duration_s:.4g} s), {len(info.cameras)} cameras, "
        f"{info.n_joints} joints ({info.skeleton}), {views}"
    )
    console.print(_seen_table(info))
    console.print(_check_table(info.cameras))
    for gap in info.gaps[:_MAX_GAPS]:
        console.print(
            f"gap: {gap.joint} seen by fewer than two cameras for {gap.duration_s:.2f} s from {gap.start_s:.2f} s"
        )
    if len(info.gaps) > _MAX_GAPS:
        console.print(f"gap: {len(info.gaps) - _MAX_GAPS} shorter ones")
    remarks = list(hints(info))
    for remark in remarks:
        console.print(f"! {remark}")
    if not info.suspicious:
        console.print("Nothing is clearly wrong." if remarks else "Nothing suspicious.")


def hints(info: RecordingInfo) -> Iterator[str]:
    """What looks wrong, and what to do about it, in plain words."""
    for remark in info.implausible:
        yield f"Implausible: {remark}. Millimetres taken for metres, or the reverse? See --unit and --points3d-unit."
    if info.suspected_calibration:
        yield (
            f"The calibration of {info.suspected_calibration} looks wrong: the other cameras agree without it and miss "
            "it by far. Has it been moved, or are two cameras exchanged? Calibrate it again, or leave it out with "
            "--cameras. Other suspicions only count once this is settled."
        )
    if info.disagreeing:
        (camera,) = (camera for camera in info.cameras if camera.name == info.disagreeing)
        yield (
            f"{camera.name} misses what the other cameras agree on by {camera.residual_px:.0f} px, mostly by a "
            "constant: its calibration may be a little off. Try --refine-calibration."
        )
    for name, frames in info.suspected_shifts:
        yield f"{name} looks {_lateness(frames, '.1f')}. Shift its images, then look again."
    if info.possible_shift:
        yield _possible_shift(info)
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


def _possible_shift(info: RecordingInfo) -> str:
    assert info.possible_shift is not None
    name, frames = info.possible_shift
    (camera,) = (camera for camera in info.cameras if camera.name == name)
    return (
        f"{name} may be up to {_lateness(frames, '.0f')}: read so, its error falls by "
        f"{100 * camera.uncorrected_gain:.0f} %. But with its constant offset of {camera.offset_px:.0f} px removed "
        f"{camera.shift_frames:+.1f} frames fit best: part or all of it may be calibration (principal point, image "
        "size)."
    )


def _lateness(frames: float, form: str) -> str:
    return f"{format(abs(frames), form)} frames {'late' if frames > 0 else 'early'}"


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
    table = new_table(
        "camera", "error\n[px]", "90 %\n[px]", "left out\n[px]", "offset\n[px]", "late\n[frames]", "swapped\n[%]"
    )
    table.caption = (
        "error: distance to the triangulation of all cameras (median, 90 % quantile). left out: to that of the other "
        "cameras alone; offset: the part of it that is constant. late: what fits best once the offset is removed "
        "(- early). swapped: left and right exchanged."
    )
    table.caption_justify = "left"
    for camera in cameras:
        errors_px = camera.residual_px, camera.residual_q90_px, camera.left_out_px, camera.offset_px
        table.add_row(
            camera.name,
            *(_number(error_px, ".1f") for error_px in errors_px),
            _number(camera.shift_frames, "+.1f"),
            _number(100 * camera.share_swapped, ".1f"),
        )
    return table


def _number(value: float, form: str) -> str:
    return "-" if np.isnan(value) else format(value, form)
