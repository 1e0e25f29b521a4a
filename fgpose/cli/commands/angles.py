"""Joint angles of a result. The docstring is what --help prints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np
from tyro.conf import Positional, UseAppendAction, arg

from fgpose.cli.console import new_console, new_table, print_written
from fgpose.geometry.up_axis import UpChoice
from fgpose.plain_files import naming

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from fgpose.kinematics.angles import JointAngles
    from fgpose.trajectory import Trajectory

_REMEDY = "choose another file with -o"


@dataclass(frozen=True, kw_only=True)
class Angles:
    """Joint angles of a result, by the recommendations of the ISB.

    Prints their ranges, and writes them. The least and the greatest of an angle are without what noise adds to the
    extremes of a curve, each ± its own standard deviation; what is written has the noise in it.

    Flexion, adduction, internal rotation and dorsiflexion are positive, as are bending and obliquity to the right and
    rotation to the left. A straight knee or elbow has flexion 0; the shoulder's plane of elevation is 0 in abduction
    and 90 in forward flexion. Where joints do not determine an angle (hip rotation of a straight leg), there is a gap.

    Each -o FILE is written as its extension says: .parquet and .csv have angles, speeds and heights with their standard
    deviations, one row for each; .mot has the coordinates of OpenSim; .bvh is for Blender; .c3d has the rotations of
    the segments beside the points. Of several people, each has files of its own (walk_person1.mot), but all are in one
    table. A file that is there is replaced if it says that it is of this command and result.

    Example: fgpose angles out/walk.parquet -o walk.mot -o walk.bvh
    """

    file: Annotated[Positional[Path], arg(metavar="RESULT")]
    """A result, or any trajectory file: parquet, npz, TRC, C3D."""
    output: Annotated[UseAppendAction[tuple[Path, ...]], arg(metavar="FILE", aliases=("-o",))] = ()
    """File to be written: .parquet, .csv, .mot, .bvh or .c3d. May be given several times."""
    world_up: UpChoice = "auto"
    """What is up in the world of the file: +x, -x, +y, -y, +z or -z; auto: as its format says, unless people (and
    cameras, which a parquet of fgpose knows) stand otherwise."""

    step: ClassVar[str] = "angles"

    def run(self) -> None:
        from fgpose.io.made_by import refuse_inputs
        from fgpose.io.trajectories import load_upright
        from fgpose.io.trajectories.kinematics import check_kinematics_output
        from fgpose.kinematics.angles import joint_angles

        for path in self.output:
            check_kinematics_output(path)
        refuse_inputs(self.output, [self.file], _REMEDY)
        (people, _), console = load_upright(self.file, self.world_up), new_console()
        self._check(people)
        for person, trajectory in people.items():
            with naming(self.file):
                angles = joint_angles(trajectory)
            whose = f"person {person}, " if len(people) > 1 else ""
            console.print(f"{whose}{trajectory.n_frames} frames, skeleton {trajectory.skeleton.name}")
            console.print(ranges_table(angles))
        if self.output:
            self._write(people, console)

    def _check(self, people: Mapping[int, Trajectory]) -> None:
        """Raise ValueError before any work where a format cannot hold them, or a file is there that is not of this
        command and this result."""
        from fgpose.io.made_by import refuse_others
        from fgpose.io.trajectories.kinematics import check_kinematics_output, kinematics_paths

        of_a_name: dict[Path, list[Path]] = {}
        for path in self.output:
            check_kinematics_output(path, people.values())
            for own in kinematics_paths(path, people):
                of_a_name.setdefault(own.with_suffix(""), []).append(own)
        for paths in of_a_name.values():
            refuse_others(paths, self.step, self.file, f"{_REMEDY}, or remove it")

    def _write(self, people: Mapping[int, Trajectory], console: Console) -> None:
        """All files that can be written. Raises OutputError that names the others."""
        from fgpose.io.origin import Origin, input_file
        from fgpose.io.trajectories.kinematics import save_kinematics
        from fgpose.pipeline.outputs import write_all

        origin = Origin((input_file("Result", self.file),), step=self.step, fgpose=version("fgpose"))

        def write(path: Path) -> None:
            print_written(console, *save_kinematics(people, path, "z", origin))

        write_all({path: partial(write, path) for path in self.output})


def ranges_table(angles: JointAngles) -> Table:
    """One row per angle: least, median and greatest value without what noise adds, each with its standard deviation;
    by how much the curve that is written goes beyond both extremes together; and in how many frames the angle is
    determined."""

    table = new_table("angle [deg]", "min", "median", "max", "noise", "known")
    for column in table.columns[1:]:
        column.no_wrap = True
    found = angles.ranges((0.0, 0.5, 1.0))
    for index, name in enumerate(angles.names):
        pairs = zip(found.quantiles_deg[:, index].tolist(), found.sigma_deg[:, index].tolist(), strict=True)
        noise_deg = float(found.noise_deg[-1, index] - found.noise_deg[0, index])
        known = np.isfinite(angles.angle_deg[:, index])
        share = 100 * float(known.mean()) if len(known) else 0.0
        cells = [*(_with_sigma(*pair) for pair in pairs), _with_sigma(noise_deg, np.nan)]
        table.add_row(name.replace("_", " "), *cells, f"{share:.0f}%")
    return table


def _with_sigma(value: float, sigma: float) -> str:
    if not np.isfinite(value):
        return "-"
    return f"{value:.0f} ± {sigma:.0f}" if np.isfinite(sigma) else f"{value:.1f}"
