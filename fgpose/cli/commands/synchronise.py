"""When the cameras of a calibrated rig began to film."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import arg

from fgpose.cli.console import new_console, new_table, print_written
from fgpose.cli.delivery import look_at
from fgpose.cli.options import KeypointOptions

if TYPE_CHECKING:
    from rich.table import Table

    from fgpose.calibration.synchronisation import Synchronised


@dataclass(frozen=True, kw_only=True)
class Synchronise(KeypointOptions):
    """Find when each camera began, from the motion of a person.

    Takes the person who is seen most, and writes the starts into the calibration. For cameras that are calibrated but
    were started by hand: one calibration serves all recordings of a session, and each gets its own starts. Ten seconds
    of somebody who moves are enough, wherever the videos begin. Of videos, fgpose detect makes the keypoints.

    Example: fgpose synchronise pose/ --rig rig.toml --skeleton body_25b --fps 60 -o take_1.toml, then fgpose smooth
    pose/ --rig take_1.toml --skeleton body_25b --fps 60
    """

    output: Annotated[Path, arg(metavar="FILE", aliases=("-o",))] = Path("synchronised.toml")
    """The calibration with the starts (time_offset_s): Pose2Sim TOML, or npz of fgpose."""

    def run(self) -> None:
        from fgpose.calibration.synchronisation import synchronise
        from fgpose.io.calibration import check_format, load_calibration_origin, load_rig, save_rig
        from fgpose.io.keypoints import load_people
        from fgpose.io.made_by import check_result
        from fgpose.pipeline.origin import synchronised

        check_format(self.output)
        check_result(self.output, "synchronise", (self.keypoints, self.rig))
        console = new_console()
        rig = load_rig(self.rig, self.unit)
        rig = rig.subset(self.cameras) if self.cameras else rig
        reading = {"fps": self.fps, "ignore_other_cameras": bool(self.cameras)}
        people = load_people(self.keypoints, rig, self.skeleton, **reading)
        with new_console(stderr=True).status("comparing the motion that the cameras show"):
            found = synchronise(people, rig)
        known = synchronised(load_calibration_origin(self.rig), found)
        save_rig(found.rig, self.output, origin=replace(known, step="synchronise"))
        console.print(_table(found))
        for finding in found.findings:
            remedy = finding.remedy[0].upper() + finding.remedy[1:]
            console.print(f"{finding.camera}: {finding.reason}. {remedy}.", soft_wrap=True)
        if found.left_out:
            left_out, kept = ", ".join(found.left_out), " ".join(found.rig.names)
            console.print(
                f"Left out, as their starts are not known: {left_out}. Use the others: --cameras {kept}",
                soft_wrap=True,
            )
        print_written(console, self.output)
        look_at(console, people, found.rig)


def _table(found: Synchronised) -> Table:
    begun_s = found.rig.time_offsets_s - found.rig.time_offsets_s[0]
    rows = {
        "began later than the first [s]": [f"{value:.3f}" for value in begun_s],
        "standard deviation [ms]": [f"{1000 * value:.1f}" for value in found.sigma_s],
    }
    return new_table("synchronisation", *found.rig.names, rows=rows)
