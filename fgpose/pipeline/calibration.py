"""Writing and showing a calibration from people or with boards, or what was bumped since."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from fgpose.calibration.board.calibrate import CalibratedFromBoards
from fgpose.calibration.bumped import BumpedRig
from fgpose.calibration.from_people.calibrated import CalibratedFromPeople, Grade, worst_grade
from fgpose.geometry.camera import CameraRig
from fgpose.io.calibration import CalibrationOrigin, RigFormat, save_rig, write_lenses
from fgpose.people_observations import PeopleObservations
from fgpose.pipeline.origin import after_bumps, calibration_from_boards, calibration_from_people, reasons
from fgpose.pipeline.outputs import write_all
from fgpose.pipeline.seen_walk import SeenWalk, of_boards, of_bumped, of_calibrated, show_walk
from fgpose.viewer import CalibrationRecording, open_calibration_recording

Display = Callable[[SeenWalk, CalibrationRecording], None]


def write_calibration(
    result: CalibratedFromPeople,
    path: Path,
    file_format: RigFormat = "auto",
    rrd: Path | None = None,
    display: Display | None = None,
    step: str = "calibrate",
) -> tuple[Path, ...]:
    """Write the rig, unless the calibration failed, and the scene for the viewer, which shows why too.

    Args:
        result: of the calibration.
        path: of the rig, see save_rig.
        file_format: of the rig.
        rrd: of the scene; None: there is none.
        display: how it is shown, show_walk by default.
        step: the command that writes it, which its file says.

    Returns:
        The files.

    Raises:
        OutputError: one could not be written; the others were.
    """
    rig = None if result.grade is Grade.FAILED else result.rig
    known = replace(calibration_from_people(result), step=step)
    return _write(rig, known, path, file_format, rrd, lambda: of_calibrated(result), display)


def write_board_calibration(
    result: CalibratedFromBoards,
    path: Path,
    file_format: RigFormat = "auto",
    rrd: Path | None = None,
    display: Display | None = None,
) -> tuple[Path, ...]:
    """The same of a calibration with boards.

    Raises:
        OutputError: a file could not be written; the others were.
    """
    rig = None if result.grade is Grade.FAILED else result.rig
    known = replace(calibration_from_boards(result), step="calibrate")
    return _write(rig, known, path, file_format, rrd, lambda: of_boards(result), display)


def write_board_lenses(results: Sequence[CalibratedFromBoards], path: Path) -> tuple[Path, ...]:
    """Write the lenses of cameras that were calibrated one by one, without poses, unless one of them failed.

    Returns:
        The files.

    Raises:
        OutputError: the file could not be written.
    """
    findings = [finding for result in results for finding in result.findings]
    if worst_grade(findings) is Grade.FAILED:
        return ()
    rig = CameraRig(tuple(camera for result in results for camera in result.rig.cameras))
    known = CalibrationOrigin(grade=worst_grade(findings).value, findings=reasons(findings), step="calibrate")
    return write_all({path: partial(write_lenses, rig, path, known)})


def write_bumped(
    bumped: BumpedRig[PeopleObservations],
    given: CameraRig,
    path: Path,
    file_format: RigFormat = "auto",
    rrd: Path | None = None,
    display: Display | None = None,
    known: CalibrationOrigin | None = None,
) -> tuple[Path, ...]:
    """Write the rig in which the cameras that were bumped have new poses, and the scene, which shows the old ones too.

    Args:
        bumped: what was found.
        given: the rig as its file has it: its clocks are kept.
        path, file_format, rrd, display: as of write_calibration.
        known: of the rig that was given, which the file then says too.

    Returns:
        The files; without the rig if the cameras still disagree.

    Raises:
        OutputError: one could not be written; the others were.
    """
    rig = None if bumped.grade is Grade.FAILED else bumped.rig.with_time_offsets(given.time_offsets_s)
    origin = replace(after_bumps(known or CalibrationOrigin(), bumped), step="calibrate")
    return _write(rig, origin, path, file_format, rrd, lambda: of_bumped(bumped, given), display)


def _write(
    rig: CameraRig | None,
    origin: CalibrationOrigin,
    path: Path,
    file_format: RigFormat,
    rrd: Path | None,
    seen: Callable[[], SeenWalk],
    display: Display | None,
) -> tuple[Path, ...]:
    writers: dict[Path | str, Callable[[], object]] = {}
    if rig is not None:
        writers[path] = partial(save_rig, rig, path, file_format, origin)
    if rrd is not None:
        writers[rrd] = lambda: _write_scene(seen(), rrd, display or show_walk)
    return write_all(writers)


def _write_scene(seen: SeenWalk, path: Path, display: Display) -> None:
    with open_calibration_recording(path, seen.rig, seen.walk.skeleton, n_frames=len(seen.walk.time_s)) as recording:
        display(seen, recording)


def show_calibrated(result: CalibratedFromPeople, recording: CalibrationRecording) -> None:
    """Show the cameras, the walk, what every camera saw of it, and how well they agree."""
    show_walk(of_calibrated(result), recording)
