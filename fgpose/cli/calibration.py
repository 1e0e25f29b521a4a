"""Calibrating the cameras on the recording before it is estimated: saves and prints the result."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fgpose.cli.options import new_console

if TYPE_CHECKING:
    from rich.console import Console

    from fgpose.cli.options import AnySource
    from fgpose.config import Config
    from fgpose.pipeline import Outputs


def calibrated(
    source: AnySource, config: Config, outputs: Outputs, console: Console, *, poses: bool, clocks: bool
) -> AnySource:
    """The recording with refined camera poses, with estimated time offsets, with both or with neither.

    Of several people, the one who is seen most is what the cameras are calibrated on. Writes the resulting calibration
    as NAME_calibration.toml and prints what has changed.
    """
    from fgpose.calibration.moved_views import people_moved_with_cameras
    from fgpose.calibration.self_calibration import calibrate_cameras
    from fgpose.cli.tables import calibration_table
    from fgpose.io.calibration import save_rig
    from fgpose.pipeline import PeopleSource, Source

    if not poses and not clocks:
        return source
    one = source.one() if isinstance(source, PeopleSource) else source
    with new_console(stderr=True).status("calibrating the cameras"):
        result = calibrate_cameras(one.observations, one.rig, config, poses=poses, clocks=clocks)
    path = outputs.folder / f"{outputs.name}_calibration.toml"
    save_rig(result.rig, path)
    calibrated = Source(result.rig, result.observations)
    console.print(calibration_table(calibrated, result.refinement, result.time_offsets))
    if not result.converged:
        console.print("The calibration has not converged: raise --calibration.max-rounds or --solver.max-iterations.")
    console.print(f"wrote {path}", soft_wrap=True)
    if isinstance(source, PeopleSource):
        return PeopleSource(result.rig, people_moved_with_cameras(source.people, source.rig, result.rig))
    return calibrated
