"""What is seen in a recording, how well the cameras agree, and what is probably wrong."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np
from rich.console import Console
from rich.table import Table
from tyro.conf import arg

from fgpose.cli.console import new_console, new_table, number, progress_bar
from fgpose.cli.options import RecordingOptions

if TYPE_CHECKING:
    from collections.abc import Sequence

    from fgpose.assessment.recording_info import CameraInfo, Gap, RecordingInfo
    from fgpose.association.recording import Association
    from fgpose.geometry.camera import CameraRig
    from fgpose.people_observations import PeopleObservations

# More would hide the rest of the report.
_MAX_GAPS = 10
_AT_ONCE_S = 0.5


@dataclass(frozen=True, kw_only=True)
class Info(RecordingOptions):
    """Say what a recording shows, and what is probably wrong.

    How many people there seem to be, and when; which cameras see what, how well they agree, whether a calibration is
    wrong, a camera was moved or is late, left and right are exchanged, or millimetres are taken for metres. Takes some
    seconds. Nothing is written. Errors are pixels of the undistorted image.

    Example: fgpose info pose/ --rig Calib.toml --skeleton body_25b --fps 60
    """

    min_gap_s: Annotated[float, arg(metavar="SECONDS")] = 0.5
    """List gaps in which fewer than two cameras see a joint for longer than this, seconds."""

    def run(self) -> None:
        from fgpose.assessment.recording_info import recording_info
        from fgpose.cli.delivery import print_findings
        from fgpose.cli.tables import print_association, print_presence
        from fgpose.pipeline.diagnosed import Subject

        source, console = self.load(), new_console()
        subject = Subject.of(source, _told_apart)
        if subject.everybody is not None:
            print_association(console, subject.everybody, source.succession)
            console.print("Of the person who is seen most; late and moved cameras by everybody:")
        else:
            if source.chosen is not None and source.chosen.n_people > 1:
                console.print(f"Looked at is {source.chosen}.", soft_wrap=True)
            print_presence(console, source)
        with new_console(stderr=True).status("comparing the cameras"):
            info = recording_info(subject.source.observations, subject.source.rig, self.min_gap_s)
            diagnosis = subject.diagnosis()
        print_info(console, info)
        print_findings(console, diagnosis)


def _told_apart(people: PeopleObservations, rig: CameraRig) -> Association:
    from fgpose.association.recording import associate

    with progress_bar("telling people apart") as progress:
        return associate(people, rig, progress=progress)


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
    together, n_shorter = _gaps_together(info.gaps)
    for longest, *others in together:
        n_joints = 1 + len({gap.joint for gap in others} - {longest.joint})
        joints = longest.joint if n_joints == 1 else f"{'all ' * (n_joints == info.n_joints)}{n_joints} joints"
        console.print(
            f"gap: {joints} seen by fewer than two cameras for {longest.duration_s:.2f} s from {longest.start_s:.2f} s"
        )
    if n_shorter:
        console.print(f"gap: {n_shorter} shorter ones")


def _gaps_together(gaps: Sequence[Gap]) -> tuple[list[list[Gap]], int]:
    """The longest, of all joints that are not seen at that time, the longest of each first; and how many are left."""
    together: list[list[Gap]] = []
    n_left = 0
    for gap in gaps:
        same = next((each for each in together if _is_same(each[0], gap)), None)
        if same is not None:
            same.append(gap)
        elif len(together) < _MAX_GAPS:
            together.append([gap])
        else:
            n_left += 1
    return together, n_left


def _is_same(longest: Gap, gap: Gap) -> bool:
    """Whether somebody who leaves and comes back makes both: joints are detected some images earlier or later."""
    later_s = gap.start_s - longest.start_s
    return abs(later_s) < _AT_ONCE_S and abs(later_s + gap.duration_s - longest.duration_s) < _AT_ONCE_S


def _seen_table(info: RecordingInfo) -> Table:
    """What each camera sees, and how many cameras see a joint at a time."""
    table = new_table("camera", "joints seen", "confidence", "distance [m]")
    for camera in info.cameras:
        seen = f"{100 * camera.share_seen:.0f} %"
        table.add_row(camera.name, seen, number(camera.confidence, ".2f"), number(camera.distance_m, ".2f"))
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
            *(number(error_px, ".1f") for error_px in errors_px),
            number(100 * camera.share_swapped, ".1f"),
        )
    return table
