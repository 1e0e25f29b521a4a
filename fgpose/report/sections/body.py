"""Uncertainty of the joints and lengths of the bones."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.diagnosis.finished import FinishedRecording
from fgpose.diagnosis.series import quantile_of_frames, sigma_m
from fgpose.diagnosis.solution_checks import sigma_ratio
from fgpose.report.blocks import Block, Folded, Note, Section, Table, TableCell, number
from fgpose.report.plots import heat_map, lines
from fgpose.report.sections.cameras import span_text
from fgpose.report.sections.people import of_everybody, of_people
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Trajectory
from fgpose_factors.robust_statistics import known_quantile

NO_COVARIANCE = (
    "The result has no covariance: estimate it with --uncertainty.covariance, and save it as parquet or npz."
)
# From sure to unsure: pale where nothing is to be looked at.
_SIGMA_PALETTE = ("#d8e9ec", "#bcd9dd", "#f2cfa9", "#e8975a", "#d55e00", "#9c3f00")
_BONES_SHOWN = 4


def sigma_section(recording: FinishedRecording) -> Section:
    """Standard deviation of the joints over time."""
    intro = (
        "The standard deviation of each joint along the axis in which it is largest, from the covariance: where "
        "it is high, the position rests on bones and motion rather than on cameras."
    )
    if all(trajectory.covariance_m2 is None for trajectory in recording.people.values()):
        return Section("Uncertainty", "sigma", [Note(NO_COVARIANCE, is_missing=True)])
    blocks = [*of_people(recording, _sigma_plots), _sigma_table(recording)]
    ratio = sigma_ratio(recording)
    if np.isfinite(ratio):
        blocks.append(Note(
            f"Against residuals: sigma is {ratio:.2f} times that of one frame alone, by the reprojection errors "
            "as they are. Between 1/3 and 3 the two fit; smoothing makes it smaller than one."
        ))  # fmt: skip
    return Section("Uncertainty", "sigma", blocks, intro)


def _sigma_plots(trajectory: Trajectory, columns: int) -> list[Block]:
    sigma_mm = 1000 * sigma_m(trajectory)
    if not np.isfinite(sigma_mm).any():
        return [Note(NO_COVARIANCE, is_missing=True)]
    curves = {"median of the joints": quantile_of_frames(sigma_mm), "worst joint": quantile_of_frames(sigma_mm, 1.0)}
    rows = {joint: sigma_mm[:, j] for j, joint in enumerate(trajectory.skeleton.joints)}
    limits = 0.0, 3 * known_quantile(sigma_mm, 0.5)
    caption = "Sigma of each joint; the strongest colour is three times the median, or more"
    each_joint = heat_map(rows, trajectory.time_s, _SIGMA_PALETTE, limits, "sigma / mm", caption, columns=columns)
    over_time = lines(
        curves, trajectory.time_s, "sigma / mm", "Sigma over time", from_zero=True, peaks=True, columns=columns
    )
    known_mm = sigma_mm[np.isfinite(sigma_mm)]
    is_high = np.mean(known_mm > 2 * known_quantile(sigma_mm, 0.5))
    frame, joint = np.unravel_index(int(np.nanargmax(sigma_mm)), sigma_mm.shape)
    said = (
        f"Sigma of each joint over time: {known_mm.max():.0f} mm at most, of {trajectory.skeleton.joints[joint]} at "
        f"{trajectory.time_s[frame]:.2f} s; {100 * is_high:.1f} % of it is more than twice the median"
    )
    return [over_time, Folded(said, (each_joint,))]


def _sigma_table(recording: FinishedRecording) -> Folded:
    people = list(recording.people.values())
    sigma_mm = 1000 * np.concatenate([sigma_m(trajectory) for trajectory in people])
    status = np.concatenate([trajectory.status for trajectory in people])
    usual_mm = known_quantile(sigma_mm, 0.5)
    medians_mm = {joint: known_quantile(sigma_mm[:, j], 0.5) for j, joint in enumerate(recording.main.skeleton.joints)}
    rows = [
        (
            TableCell(joint),
            number(medians_mm[joint], worst=4 * usual_mm),
            number(known_quantile(sigma_mm[:, j], 0.95), worst=4 * usual_mm),
            number(known_quantile(sigma_mm[:, j], 1.0)),
            TableCell(f"{100 * np.mean(status[:, j] == 2):.1f} %", key=float(np.mean(status[:, j] == 2))),
        )
        for j, joint in enumerate(recording.main.skeleton.joints)
    ]
    columns = ("joint", "median / mm", "95 % / mm", "largest / mm", "seen by two")
    title = f"Sigma of the joints{of_everybody(recording)}: median {span_text(medians_mm, 'mm')}"
    return Folded(title, (Table(columns, tuple(rows)),))


def bone_section(recording: FinishedRecording) -> Section:
    """Lengths over time, and left against right."""
    intro = "Bones keep their lengths: what changes here is error. Deviations are from the median of each bone."
    if not recording.main.skeleton.bones:
        missing = (
            f"Skeleton {recording.main.skeleton.name} has no bones. TRC and C3D files hold none: report the parquet or "
            "npz of the same result, which do."
        )
        return Section("Bone lengths", "bones", [Note(missing, is_missing=True)])
    return Section("Bone lengths", "bones", of_people(recording, _bone_blocks), intro)


def _bone_blocks(trajectory: Trajectory, columns: int) -> list[Block]:
    skeleton = trajectory.skeleton
    lengths_mm = 1000 * skeleton.bone_lengths(trajectory.positions_m)
    spread = [known_quantile(np.abs(own - known_quantile(own, 0.5)), 0.9) for own in lengths_mm.T]
    order = np.argsort(-np.nan_to_num(np.array(spread)))
    deviations = {
        skeleton.bone_name(skeleton.bones[b]): lengths_mm[:, b] - known_quantile(lengths_mm[:, b], 0.5)
        for b in order[:12].tolist()
    }
    caption = "Deviation of the bones that vary most; click on the legend for more"
    return [
        lines(
            deviations, trajectory.time_s, "deviation / mm", caption, shown=_BONES_SHOWN, height_px=280, columns=columns
        ),
        _bone_table(skeleton, lengths_mm),
    ]


def _bone_table(skeleton: Skeleton, lengths_mm: Float[np.ndarray, "frame bone"]) -> Folded:
    number_of = {frozenset(bone): b for b, bone in enumerate(skeleton.bones)}
    rows, differences_mm = [], dict[str, float]()
    done = set()
    for b, bone in enumerate(skeleton.bones):
        other = number_of.get(frozenset(skeleton.mirrored(bone)), b)
        if b in done:
            continue
        done |= {b, other}
        own_mm, other_mm = known_quantile(lengths_mm[:, b], 0.5), known_quantile(lengths_mm[:, other], 0.5)
        is_pair = other != b
        name = skeleton.bone_name(bone).replace("left_", "") if is_pair else skeleton.bone_name(bone)
        if is_pair and np.isfinite(own_mm - other_mm):
            differences_mm[name] = own_mm - other_mm
        rows.append((
            TableCell(name), number(own_mm, 0),
            number(other_mm if is_pair else np.nan, 0),
            number(own_mm - other_mm if is_pair else np.nan, 1, worst=20.0),
            number(known_quantile(np.abs(lengths_mm[:, [b, other]] - [own_mm, other_mm]), 0.68)),
        ))  # fmt: skip
    columns = ("bone", "left or middle / mm", "right / mm", "difference / mm", "variation / mm")
    hints = ("", "median over time", "median over time", "", "68 % of the deviations from the median are smaller")
    title = "Lengths of the bones"
    if differences_mm:
        name = max(differences_mm, key=lambda bone: abs(differences_mm[bone]))
        title += f": left and right differ by {abs(differences_mm[name]):.0f} mm at most ({name})"
    return Folded(title, (Table(columns, tuple(rows), hints=hints),))
