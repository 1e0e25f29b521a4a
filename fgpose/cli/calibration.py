"""Calibrating the cameras on the recording before it is estimated: saves and prints the result."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fgpose.cli.options import new_console

if TYPE_CHECKING:
    from rich.console import Console

    from fgpose.config import Config
    from fgpose.pipeline import Outputs, Source


def calibrated(
    source: Source, config: Config, outputs: Outputs, console: Console, *, poses: bool, clocks: bool
) -> Source:
    """The recording with refined camera poses, with estimated time offsets, with both or with neither.

    Writes the resulting calibration as NAME_calibration.toml and prints what has changed.
    """
    from fgpose.calibration.self_calibration import calibrate_cameras
    from fgpose.cli.tables import calibration_table
    from fgpose.io.calibration import save_rig
    from fgpose.pipeline import Source

    if not poses and not clocks:
        return source
    with new_console(stderr=True).status("calibrating the cameras"):
        result = calibrate_cameras(source.observations, source.rig, config, poses=poses, clocks=clocks)
    path = outputs.folder / f"{outputs.name}_calibration.toml"
    save_rig(result.rig, path)
    calibrated = Source(result.rig, result.observations)
    console.print(calibration_table(calibrated, result.refinement, result.time_offsets))
    if not result.converged:
        console.print("The calibration has not converged: raise --calibration.max-rounds or --solver.max-iterations.")
    console.print(f"wrote {path}", soft_wrap=True)
    return calibrated
