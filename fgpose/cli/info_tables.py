"""What is seen in a recording, and how well the cameras agree, in tables."""

from __future__ import annotations

import numpy as np
from rich.console import Console
from rich.table import Table

from fgpose.assessment.recording_info import CameraInfo, RecordingInfo
from fgpose.cli.tables import new_table

# More would hide the rest of the report.
_MAX_GAPS = 10


def print_info(console: Console, info: RecordingInfo) -> None:
    """What is seen by whom, and for how long it is not."""
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


def _number(value: float, form: str) -> str:
    return "-" if np.isnan(value) else format(value, form)
