"""Calibrating the cameras on the recording before it is estimated: saves and prints the result."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from fgpose.cli.console import new_console, print_written
from fgpose.cli.process import command_line

if TYPE_CHECKING:
    from rich.console import Console

    from fgpose.calibration import Ending
    from fgpose.calibration.moved_views import Recording
    from fgpose.calibration.self_calibration import CameraCalibration
    from fgpose.config import Config
    from fgpose.geometry.camera import CameraRig
    from fgpose.io.origin import Origin
    from fgpose.pipeline import Outputs, Source


def calibrated(
    source: Source[Recording], config: Config, outputs: Outputs, console: Console, *, poses: bool, clocks: bool
) -> Source[Recording]:
    """The recording with refined camera poses, with estimated time offsets, with both or with neither.

    Of several people, the cameras are calibrated on all. Writes the resulting calibration as NAME_calibration.toml and
    prints what has changed.
    """
    from fgpose.pipeline import run_calibrate

    if source.origin is not None:
        source = replace(source, origin=replace(source.origin, command=command_line()))
    if not poses and not clocks:
        return source
    with new_console(stderr=True).status("calibrating the cameras"):
        after, found = run_calibrate(source, config, poses=poses, clocks=clocks)
    _save_and_print(found, after.origin, source.observations.frame_time_s, outputs, console)
    return after


def _save_and_print(
    calibration: CameraCalibration, origin: Origin | None, frame_time_s: np.ndarray, outputs: Outputs, console: Console
) -> None:
    """Of cameras that began at different moments the rig of the origin has the starts; that of the calibration only
    what is left of them after the images were put together."""
    from fgpose.cli.tables import calibration_table
    from fgpose.io.calibration import CalibrationOrigin, save_rig

    if origin is None or origin.rig is None:
        written, known = calibration.rig, CalibrationOrigin(step=outputs.step)
    else:
        written, known = origin.rig, replace(origin.calibration, step=outputs.step)
    save_rig(written, outputs.calibration, origin=known)
    console.print(calibration_table(_with_offsets_of(calibration, written), frame_time_s))
    if calibration.refinement is not None:
        console.print(
            "All cameras and joints together may be shifted by "
            f"{1000 * calibration.refinement.shift_sigma_m:.0f} mm along each axis (one standard deviation)."
        )
    if calibration.reassigned:
        shares = ", then ".join(f"{100 * share:.1f} %" for share in calibration.reassigned)
        console.print(f"With it, {shares} of the joints in a camera, at most, belong to somebody else.")
    if not calibration.ending.converged:
        console.print(f"The calibration has not converged: {_what_helps(calibration.ending)}.")
    print_written(console, outputs.calibration)


def _with_offsets_of(calibration: CameraCalibration, written: CameraRig) -> CameraCalibration:
    """With the time offsets that are written, relative to the first camera."""
    from fgpose.geometry.changing_rig import pieces_of

    found = calibration.time_offsets
    if found is None:
        return calibration
    written_s = {piece.name: camera.time_offset_s for camera in written.cameras for piece in pieces_of(camera)}
    left_s = dict(zip(calibration.rig.names, found.offsets_s.tolist(), strict=True))
    offsets_s = np.array([written_s.get(name, left_s[name]) for name in calibration.rig.names])
    return replace(calibration, time_offsets=replace(found, offsets_s=offsets_s - offsets_s[0]))


def _what_helps(ending: Ending) -> str:
    from fgpose.calibration import Ending

    if ending is Ending.ADJUSTMENT:
        return "what the cameras saw hardly determines them; see fgpose info"
    return f"raise {'--calibration.max-rounds' if ending is Ending.ROUNDS else '--solver.max-iterations'}"
