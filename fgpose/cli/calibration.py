"""Calibrating the cameras on the recording itself before it is estimated."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fgpose.cli.options import new_console

if TYPE_CHECKING:
    from rich.console import Console

    from fgpose.calibration.rig_refinement import RigRefinement
    from fgpose.calibration.time_offsets import TimeOffsets
    from fgpose.config import Config
    from fgpose.pipeline import Outputs, Source


def calibrated(
    source: Source, config: Config, outputs: Outputs, console: Console, *, poses: bool, clocks: bool
) -> Source:
    """The recording with its cameras refined, their time offsets estimated, both or neither.

    Writes the calibration that results as NAME_calibration.toml and says what has changed.
    """
    from fgpose.cli.tables import calibration_table
    from fgpose.io.calibration import save_rig

    if not poses and not clocks:
        return source
    with new_console(stderr=True).status("calibrating the cameras"):
        result, refinement, offsets = _calibrate(source, config, poses=poses, clocks=clocks)
    path = outputs.folder / f"{outputs.name}_calibration.toml"
    save_rig(result.rig, path)
    console.print(calibration_table(result, refinement, offsets))
    console.print(f"wrote {path}", soft_wrap=True)
    return result


def _calibrate(
    source: Source, config: Config, *, poses: bool, clocks: bool
) -> tuple[Source, RigRefinement | None, TimeOffsets | None]:
    from fgpose.calibration.rig_refinement import refine_rig
    from fgpose.calibration.self_calibration import self_calibrate
    from fgpose.calibration.time_offsets import estimate_time_offsets
    from fgpose.pipeline import Source

    recording = source.observations, source.rig, config
    if poses and clocks:
        both = self_calibrate(*recording)
        return Source(both.rig, both.observations), both.refinement, both.time_offsets
    if poses:
        refinement = refine_rig(*recording)
        return Source(refinement.rig, refinement.observations), refinement, None
    offsets = estimate_time_offsets(*recording)
    return Source(offsets.rig, source.observations), None, offsets
