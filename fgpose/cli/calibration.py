"""Calibrating the cameras on the recording before it is estimated: saves and prints the result."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from fgpose.cli.command_line import command_line
from fgpose.cli.options import new_console

if TYPE_CHECKING:
    import numpy as np
    from rich.console import Console

    from fgpose.calibration.self_calibration import CameraCalibration
    from fgpose.cli.options import AnySource
    from fgpose.config import Config
    from fgpose.io.origin import Origin
    from fgpose.pipeline import Outputs


def calibrated(
    source: AnySource, config: Config, outputs: Outputs, console: Console, *, poses: bool, clocks: bool
) -> AnySource:
    """The recording with refined camera poses, with estimated time offsets, with both or with neither.

    Of several people, the cameras are calibrated on all. Writes the resulting calibration as NAME_calibration.toml and
    prints what has changed.
    """
    from fgpose.calibration.self_calibration import calibrate_cameras
    from fgpose.pipeline import PeopleSource
    from fgpose.pipeline.origin import recalibrated

    if source.origin is not None:
        source = replace(source, origin=replace(source.origin, command=command_line()))
    if not poses and not clocks:
        return source
    status = new_console(stderr=True).status("calibrating the cameras")
    if isinstance(source, PeopleSource):
        with status:
            everybody = calibrate_cameras(source.people, source.rig, config, poses=poses, clocks=clocks)
        origin = source.origin and recalibrated(source.origin, source.rig, everybody)
        _save_and_print(everybody, origin, source.people.frames.frame_time_s, outputs, console)
        return replace(source, rig=everybody.rig, people=everybody.observations, origin=origin)
    with status:
        one = calibrate_cameras(source.observations, source.rig, config, poses=poses, clocks=clocks)
    origin = source.origin and recalibrated(source.origin, source.rig, one)
    _save_and_print(one, origin, source.observations.frame_time_s, outputs, console)
    return replace(source, rig=one.rig, observations=one.observations, origin=origin)


def _save_and_print(
    calibration: CameraCalibration, origin: Origin | None, frame_time_s: np.ndarray, outputs: Outputs, console: Console
) -> None:
    """Of cameras that began at different moments the rig of the origin has the starts; that of the calibration only
    what is left of them after the images were put together."""
    from fgpose.cli.tables import calibration_table
    from fgpose.io.calibration import CalibrationOrigin, save_rig

    path = outputs.folder / f"{outputs.name}_calibration.toml"
    if origin is None or origin.rig is None:
        save_rig(calibration.rig, path, origin=CalibrationOrigin(step=outputs.step))
    else:
        save_rig(origin.rig, path, origin=replace(origin.calibration, step=outputs.step))
    console.print(calibration_table(calibration, frame_time_s))
    if calibration.reassigned:
        shares = ", then ".join(f"{100 * share:.1f} %" for share in calibration.reassigned)
        console.print(f"With it, {shares} of the joints in a camera, at most, belong to somebody else.")
    if not calibration.converged:
        console.print("The calibration has not converged: raise --calibration.max-rounds or --solver.max-iterations.")
    console.print(f"wrote {path}", soft_wrap=True)
