"""Joint angles over time, with bands of one sigma."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from fgpose.report.blocks import Block, Cell, Note, Plot, Section, Table, number
from fgpose.report.camera_sections import people_shown, titled
from fgpose.report.finished import FinishedRecording
from fgpose.report.plots import lines
from fgpose.report.series import known_quantile

if TYPE_CHECKING:
    from fgpose.kinematics.angles import JointAngles

_SIDES = ("left", "right")


def angle_section(recording: FinishedRecording) -> Section:
    """Left and right of each angle in one figure."""
    from fgpose.kinematics.angles import angle_names, joint_angles

    skeleton = recording.main.skeleton
    if not angle_names(skeleton):
        missing = f"Skeleton {skeleton.name} determines no joint angle: hips, knees, ankles, shoulders, ... are needed."
        return Section("Joint angles", "angles", [Note(missing, is_missing=True)])
    blocks: list[Block] = []
    for called, trajectory in people_shown(recording):
        angles = joint_angles(trajectory, recording.world_up)
        blocks += _plots(angles, called)
        blocks.append(_table(angles, called))
    if recording.main.covariance_m2 is None:
        blocks.append(Note("No bands: the result has no covariance.", is_missing=True))
    intro = "Bands are ± one sigma, propagated from the covariance of the joints."
    return Section("Joint angles", "angles", blocks, intro)


def _plots(angles: JointAngles, called: str) -> list[Plot]:
    plots = []
    for kind, of_sides in _kinds(angles).items():
        curves = {side: angles.angle_deg[:, n] for side, n in of_sides.items()}
        bands = {side: angles.sigma_deg[:, n] for side, n in of_sides.items()}
        if any(np.isfinite(curve).any() for curve in curves.values()):
            caption = titled(kind.replace("_", " ").capitalize(), called)
            plots.append(
                lines(curves, angles.time_s, "angle / °", caption, bands=bands, height_px=200, circular=True, half=True)
            )
    return plots


def _kinds(angles: JointAngles) -> dict[str, dict[str, int]]:
    """By what is left of a name without its side: the index of each side."""
    kinds: dict[str, dict[str, int]] = {}
    for n, name in enumerate(angles.names):
        side, _, rest = name.partition("_")
        kind, side = (rest, side) if side in _SIDES else (name, "middle")
        kinds.setdefault(kind, {})[side] = n
    return kinds


def _table(angles: JointAngles, called: str) -> Table:
    rows = []
    for n, name in enumerate(angles.names):
        own_deg = angles.angle_deg[:, n]
        low, middle, high = (known_quantile(own_deg, q) for q in (0.025, 0.5, 0.975))
        share = float(np.mean(np.isfinite(own_deg)))
        rows.append((
            Cell(name.replace("_", " ")), number(low), number(middle), number(high), number(high - low),
            number(known_quantile(angles.sigma_deg[:, n], 0.5)), Cell(f"{100 * share:.0f} %", key=share),
        ))  # fmt: skip
    columns = ("angle", "2.5 % / °", "median / °", "97.5 % / °", "range / °", "sigma / °", "determined")
    return Table(columns, tuple(rows), titled("Angles", called))
