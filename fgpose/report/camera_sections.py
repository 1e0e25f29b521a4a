"""What the cameras saw, how well they agree, and where they stand."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.diagnosis.finished import FinishedRecording
from fgpose.diagnosis.residuals import together_px
from fgpose.diagnosis.series import known_quantile, quantile_of_frames
from fgpose.report.blocks import Block, Cell, Note, Plot, Section, Table, number, percent
from fgpose.report.curves import lines
from fgpose.report.person_blocks import of_everybody, of_people
from fgpose.report.plots import COLOURS, heat_map, models, plain_figure
from fgpose.report.rig_figures import plan_and_side
from fgpose.trajectory import Trajectory

NO_RESIDUALS = "The result has no reprojection errors: it is from a TRC or C3D file, or of a version that wrote none."
# From nothing seen to everything: the two ends are told apart by the colour-blind, too.
SEEN_PALETTE = ("#d55e00", "#e8975a", "#f2cfa9", "#bcd9dd", "#7fb8c2", "#3f93a5", "#0b6e86")
_MAX_JOINTS = 34


def seen_section(recording: FinishedRecording) -> Section:
    """Timeline of what each camera saw."""
    blocks: list[Block] = []
    if together_px(recording) is None:
        blocks.append(Note(NO_RESIDUALS, is_missing=True))
    return Section("What the cameras saw", "seen", [*blocks, *of_people(recording, _seen_plots)], short="Seen")


def _seen_plots(trajectory: Trajectory, columns: int) -> list[Block]:
    if trajectory.residual_px is None:
        return []
    seen = np.isfinite(trajectory.residual_px)
    shares = {name: 100 * seen[:, c].mean(axis=1) for c, name in enumerate(trajectory.camera_names)}
    views = seen.sum(axis=1).astype(float)
    rows = {joint: views[:, j] for j, joint in enumerate(trajectory.skeleton.joints[:_MAX_JOINTS])}
    whole, limits = (0.0, 100.0), (0.0, float(len(trajectory.camera_names)))
    caption = "Number of cameras that see each joint; fewer than two do not determine it"
    shown = heat_map(
        shares, trajectory.time_s, SEEN_PALETTE, whole, "seen / %", "Share of the joints that each camera sees",
        columns=columns,
    )  # fmt: skip
    return [
        shown,
        heat_map(rows, trajectory.time_s, SEEN_PALETTE, limits, "cameras / ", caption, counts=True, columns=columns),
    ]


def reprojection_section(recording: FinishedRecording) -> Section:
    """Errors per camera and joint."""
    residual_px = together_px(recording)
    intro = (
        "Distance between each detection and the projection of the result, pixels of the undistorted image. They are "
        "small where cameras agree, which is not yet a proof that they are right."
    )
    if residual_px is None:
        return Section(
            "Reprojection errors", "reprojection", [Note(NO_RESIDUALS, is_missing=True)], short="Reprojection"
        )
    blocks: list[Block] = [_per_camera(recording, residual_px), _per_joint(recording, residual_px)]
    blocks.append(_histogram(recording, residual_px))
    blocks += of_people(recording, _errors_over_time)
    return Section("Reprojection errors", "reprojection", blocks, intro, short="Reprojection")


def _errors_over_time(trajectory: Trajectory, columns: int) -> list[Block]:
    if trajectory.residual_px is None:
        return []
    medians = {name: quantile_of_frames(trajectory.residual_px[:, c]) for c, name in enumerate(trajectory.camera_names)}
    caption = "Median reprojection error of each camera over time"
    return [lines(medians, trajectory.time_s, "reprojection error / px", caption, from_zero=True, columns=columns)]


def _per_camera(recording: FinishedRecording, residual_px: Float[np.ndarray, "frame camera joint"]) -> Table:
    hints = (
        "", "share of joints and frames with a detection", "half of the errors are smaller", "90 % are smaller",
        "share of the detections that are more probably hallucinated than not",
    )  # fmt: skip
    visibility = [each.visibility for each in recording.people.values() if each.visibility is not None]
    judged = np.concatenate(visibility) if len(visibility) == len(recording.people) else None
    medians = [known_quantile(residual_px[:, c], 0.5) for c in range(len(recording.camera_names))]
    rows = []
    for c, name in enumerate(recording.camera_names):
        own = np.full(0, np.nan) if judged is None else judged[:, c][np.isfinite(judged[:, c])]
        rows.append((
            Cell(name), percent(float(np.isfinite(residual_px[:, c]).mean()), bad_below=0.5),
            number(medians[c], worst=4 * known_quantile(np.array(medians), 0.5)),
            number(known_quantile(residual_px[:, c], 0.9)), percent(float(np.mean(own < 0.5)) if own.size else np.nan),
        ))  # fmt: skip
    columns = ("camera", "seen", "median / px", "90 % / px", "hallucinated")
    return Table(columns, tuple(rows), "Cameras" + of_everybody(recording), hints=hints)


def _per_joint(recording: FinishedRecording, residual_px: Float[np.ndarray, "frame camera joint"]) -> Table:
    joints = recording.main.skeleton.joints
    medians = np.array([
        [known_quantile(residual_px[:, c, j], 0.5) for c in range(residual_px.shape[1])] for j in range(len(joints))
    ])  # fmt: skip
    worst = 4 * known_quantile(medians, 0.5)
    rows = [
        (
            Cell(joint),
            *(number(value, worst=worst) for value in medians[j]),
            number(known_quantile(residual_px[:, :, j], 0.5)),
        )
        for j, joint in enumerate(joints)
    ]
    whose = of_everybody(recording)
    caption = f"Median reprojection error of each joint{whose}, px; coloured from twice the median of all on"
    return Table(("joint", *recording.camera_names, "all"), tuple(rows), caption)


def _histogram(recording: FinishedRecording, residual_px: Float[np.ndarray, "frame camera joint"]) -> Plot:
    limit_px = 1.5 * known_quantile(residual_px, 0.95)
    edges_px = np.linspace(0, limit_px if limit_px > 0 else 1.0, 60)
    plot = plain_figure("reprojection error / px", "density / 1/px", 240)
    for c, name in enumerate(recording.camera_names):
        own_px = residual_px[:, c][np.isfinite(residual_px[:, c])]
        if own_px.size:
            count, _ = np.histogram(own_px, edges_px)
            density = count / own_px.size / (edges_px[1] - edges_px[0])
            plot.line(
                (edges_px[1:] + edges_px[:-1]) / 2, density, color=COLOURS[c % len(COLOURS)], line_width=1.8,
                legend_label=name, name=name,
            )  # fmt: skip
    plot.y_range.start = 0
    plot.add_tools(models().HoverTool(tooltips=[("", "$name"), ("error", "$x{0.0} px")], mode="mouse"))
    plot.legend.click_policy = "hide"
    plot.legend.background_fill_color = plot.legend.border_line_color = None
    whose = of_everybody(recording)
    caption = f"Distribution of the reprojection errors of each camera{whose}; the last few per cent are cut off"
    return Plot(plot, caption, 240)


def camera_section(recording: FinishedRecording) -> Section:
    """Where the cameras stand, how sure that is, and their clocks."""
    rig = recording.rig
    if rig is None:
        missing = "No calibration was given (--rig FILE), so cameras, covered volume and clocks cannot be shown."
        return Section("Cameras, calibration and clocks", "cameras", [Note(missing, is_missing=True)], short="Cameras")
    rows = []
    for camera in rig.cameras:
        offset_ms, sigma_s = 1000 * camera.time_offset_s, recording.offset_sigma_s.get(camera.name, np.nan)
        clock = f"{offset_ms:+.1f}" + (f" ± {1000 * sigma_s:.1f}" if np.isfinite(sigma_s) else "")
        x_m, y_m, z_m = camera.position_m
        rows.append((
            Cell(camera.name), Cell(f"{camera.size_px[0]} × {camera.size_px[1]}"), number(float(camera.K[0, 0]), 0),
            number(x_m, 2), number(y_m, 2), number(z_m, 2), Cell(clock, key=offset_ms),
        ))  # fmt: skip
    columns = ("camera", "image / px", "focal length / px", "x / m", "y / m", "z / m", "clock / ms")
    hints = (*6 * ("",), "time offset: how much later than its time stamps say it takes its images, ± sigma")
    blocks: list[Block] = list(plan_and_side(recording))
    blocks.append(Table(columns, tuple(rows), "Cameras in the world", hints=hints))
    if not recording.offset_sigma_s:
        blocks.append(Note("The clocks are those of the calibration; they were not estimated from this motion.", True))
    blocks += _verdict(recording)
    return Section("Cameras, calibration and clocks", "cameras", blocks, short="Cameras")


def _verdict(recording: FinishedRecording) -> list[Block]:
    if not recording.findings:
        return [Note("No verdict: the cameras were not calibrated from the people of this recording.", is_missing=True)]
    rows = [
        (Cell(finding.camera or "all"), Cell(finding.grade.value), Cell(finding.reason), Cell(finding.remedy))
        for finding in recording.findings
    ]
    columns = ("camera", "verdict", "reason", "remedy")
    return [Table(columns, tuple(rows), "Verdict of the calibration from people", numeric=(False,) * 4)]
