"""Joint angles over time, with bands that hold 95 % of what they may be."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from fgpose.diagnosis.finished import FinishedRecording
from fgpose.report.blocks import Block, Folded, Note, Plot, Section, Table, TableCell, number
from fgpose.report.plots import lines
from fgpose.report.sections.people import of_people
from fgpose.trajectory import Trajectory
from fgpose_factors.robust_statistics import known_quantile

if TYPE_CHECKING:
    from fgpose.kinematics.angles import JointAngles

_SIDES = ("left", "right")
BAND_SIGMAS = 1.96
"""Half the width of a band: 95 % of a normal distribution."""
# Less than a tenth of the time is a handful of dashes, whose figure says nothing; the table does.
_LEAST_DETERMINED = 0.1
_LEAST_SPAN_DEG = 20.0  # of an axis: errors of two degrees do not look like motion
_LONG_S = 20.0  # strides of longer recordings need the width of the page
_FIRST = ("hip_flexion", "knee_flexion", "ankle_dorsiflexion", "elbow_flexion")


def angle_section(recording: FinishedRecording) -> Section:
    """Left and right of each angle in one figure."""
    from fgpose.kinematics.angles import angle_names, joint_angles

    skeleton = recording.main.skeleton
    if not angle_names(skeleton):
        missing = f"Skeleton {skeleton.name} determines no joint angle: hips, knees, ankles, shoulders, ... are needed."
        return Section("Joint angles", "angles", [Note(missing, is_missing=True)])

    def blocks_of(trajectory: Trajectory, columns: int) -> list[Block]:
        angles = joint_angles(trajectory)
        return [*_plots(angles, columns), Folded("Angles in numbers", (_table(angles),))]

    blocks = of_people(recording, blocks_of)
    intro = (
        f"Bands are ± {BAND_SIGMAS} sigma, propagated from the covariance of the joints: they hold the angle in 95 % "
        "of the frames, if the covariance is right. Angles that are determined in less than "
        f"{100 * _LEAST_DETERMINED:.0f} % of the frames are in the table alone. There, quantiles are without what "
        "noise adds: the curves go beyond them."
    )
    if recording.main.covariance_m2 is None:
        blocks.append(Note("No bands: the result has no covariance.", is_missing=True))
        intro = ""
    return Section("Joint angles", "angles", blocks, intro)


def _plots(angles: JointAngles, columns: int) -> list[Block]:
    """The most asked for, and the others folded."""
    plots: dict[str, Plot] = {}
    is_short = float(angles.time_s[-1] - angles.time_s[0]) <= _LONG_S
    for kind, of_sides in _kinds(angles).items():
        curves = {side: angles.angle_deg[:, n] for side, n in of_sides.items()}
        bands = {side: BAND_SIGMAS * angles.sigma_deg[:, n] for side, n in of_sides.items()}
        if max(np.isfinite(curve).mean() for curve in curves.values()) >= _LEAST_DETERMINED:
            caption = kind.replace("_", " ").capitalize()
            plots[kind] = lines(
                curves, angles.time_s, "angle / °", caption, bands=bands, height_px=220, circular=True,
                least_span=_LEAST_SPAN_DEG, half=is_short, columns=columns,
            )  # fmt: skip
    first = [kind for kind in _FIRST if kind in plots] or list(plots)[: len(_FIRST)]
    others = {kind: plot for kind, plot in plots.items() if kind not in first}
    shown: list[Block] = [plots[kind] for kind in first]
    if others:
        names = ", ".join(plot.caption.lower() for plot in others.values())
        shown.append(Folded(f"{len(others)} more: {names}", tuple(others.values())))
    return shown


def _kinds(angles: JointAngles) -> dict[str, dict[str, int]]:
    """By what is left of a name without its side: the index of each side."""
    kinds: dict[str, dict[str, int]] = {}
    for n, name in enumerate(angles.names):
        side, _, rest = name.partition("_")
        kind, side = (rest, side) if side in _SIDES else (name, "middle")
        kinds.setdefault(kind, {})[side] = n
    return kinds


def _table(angles: JointAngles) -> Table:
    rows, found = [], angles.ranges((0.025, 0.5, 0.975))
    for n, name in enumerate(angles.names):
        low, middle, high = found.quantiles_deg[:, n].tolist()
        noise_deg = float(found.noise_deg[2, n] - found.noise_deg[0, n])
        share = float(np.mean(np.isfinite(angles.angle_deg[:, n])))
        numbers = low, middle, high, high - low, noise_deg, known_quantile(angles.sigma_deg[:, n], 0.5)
        determined = TableCell(f"{100 * share:.0f} %", key=share)
        rows.append((TableCell(name.replace("_", " ")), *map(number, numbers), determined))
    columns = (
        "angle",
        "2.5 % / °",
        "median / °",
        "97.5 % / °",
        "range / °",
        "noise adds / °",
        "sigma / °",
        "determined",
    )
    return Table(columns, tuple(rows))
