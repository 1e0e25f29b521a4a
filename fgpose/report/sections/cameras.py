"""What the cameras saw, how well they agree, and where they stand."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from fgpose.diagnosis.finished import FinishedRecording
from fgpose.diagnosis.series import quantile_of_frames, root_m, together_px
from fgpose.geometry.camera import Camera
from fgpose.geometry.field_of_view import in_views
from fgpose.report.blocks import Block, Folded, Note, Plot, Section, Table, TableCell, number, percent
from fgpose.report.plots import (
    COLOURS,
    Figure,
    colour_bar,
    gathered,
    heat_map,
    legend_below,
    lines,
    models,
    plain_figure,
)
from fgpose.report.sections.calibration import verdict
from fgpose.report.sections.people import of_everybody, of_people
from fgpose.sampling import spread_evenly
from fgpose.trajectory import Trajectory
from fgpose_factors.robust_statistics import known_quantile

_HEIGHT_PX = 420
_PLAN = (0, 1)  # axes of the floor
_CELLS = 44  # of the map of the covered volume, along each side
_WAY_POINTS = 500
_POSES = 5
_NAME_COLOUR = "#7a808a"  # seen on white and on the ground of the dark page alike
NO_RESIDUALS = "The result has no reprojection errors: it is from a TRC or C3D file, or of a version that wrote none."
# From nothing seen to everything: the two ends are told apart by the colour-blind, too.
SEEN_PALETTE = ("#d55e00", "#e8975a", "#f2cfa9", "#bcd9dd", "#7fb8c2", "#3f93a5", "#0b6e86")
_MAX_JOINTS = 34
# A map of which more than this share has one colour says nothing that a line does not say.
_ONE_COLOUR, _EVEN = 0.05, 0.97


def plan_and_side(recording: FinishedRecording) -> tuple[Plot, Plot]:
    """Plan, with the floor that cameras see, and side view."""
    plan, side = _view(recording, _PLAN), _view(recording, (0, 2))
    return (
        Plot(plan, "Plan: the way of the hips, and how many cameras see each place", _HEIGHT_PX, half=True),
        Plot(side, f"Side: {_POSES} poses of the recording", _HEIGHT_PX, half=True),
    )


def _view(recording: FinishedRecording, axes: tuple[int, int]) -> Figure:
    rig = recording.rig
    assert rig is not None
    is_plan = axes == _PLAN
    x_label, y_label = (f"{'xyz'[axis]} / m" for axis in axes)
    plot = plain_figure(x_label, y_label, _HEIGHT_PX, match_aspect=True)
    reach_m = 0.25 * max(np.ptp(rig.positions_m, axis=0).max(), 1.0)
    if is_plan:
        _covered(plot, recording)
    else:
        _poses(plot, recording, axes)
    for n, (person, trajectory) in enumerate(recording.people.items()):
        way_m = gathered(root_m(trajectory), _WAY_POINTS)
        colour = COLOURS[n % len(COLOURS)]
        plot.line(way_m[:, axes[0]], way_m[:, axes[1]], color=colour, line_width=1.5, name=recording.called(person))
    for camera in rig.cameras:
        corners_m = _frustum_m(camera, reach_m)
        for corner_m in corners_m:
            ends = np.stack([camera.position_m, corner_m])
            plot.line(ends[:, axes[0]], ends[:, axes[1]], color="#8a8f98", line_width=1)
        loop = [*corners_m, corners_m[0]]
        plot.line([p[axes[0]] for p in loop], [p[axes[1]] for p in loop], color="#8a8f98", line_width=1)
    places_m = rig.positions_m
    x, y = places_m[:, axes[0]], places_m[:, axes[1]]
    # Names stand inside of the figure.
    is_right = x > (x.min() + x.max()) / 2
    align, offset_px = np.where(is_right, "right", "left").tolist(), np.where(is_right, -8, 8)
    data = {"x": x, "y": y, "name": list(rig.names), "align": align, "offset_px": offset_px}
    dots = plot.scatter("x", "y", size=9, color="#d55e00", source=data)
    plot.text(
        "x", "y", "name", source=data, x_offset="offset_px", y_offset=-6, text_align="align", text_font_size="12px",
        text_color=_NAME_COLOUR,
    )  # fmt: skip
    plot.add_tools(models().HoverTool(renderers=[dots], tooltips=[("", "@name"), ("", "@x{0.00} m, @y{0.00} m")]))
    plot.xgrid.grid_line_color = plot.ygrid.grid_line_color
    plot.xgrid.grid_line_alpha = 0.5
    return plot


def _frustum_m(camera: Camera, reach_m: float) -> list[Float[np.ndarray, " 3"]]:
    """The corners of the image at a depth, in the world."""
    width, height = camera.size_px
    corners_px = np.array([(0, 0), (width, 0), (width, height), (0, height)], dtype=float)
    rays = np.linalg.solve(camera.K, np.column_stack([corners_px, np.ones(4)]).T).T
    return list(camera.to_world_frame(rays * reach_m))


def _covered(plot: Figure, recording: FinishedRecording) -> None:
    """How many cameras see each place at the height of the hips."""
    rig = recording.rig
    assert rig is not None
    ways_m = np.concatenate([root_m(trajectory) for trajectory in recording.people.values()])
    places_m = rig.positions_m
    everything_m = np.concatenate([places_m, ways_m[np.isfinite(ways_m).all(axis=1)]])
    low, high = everything_m.min(axis=0) - 0.3, everything_m.max(axis=0) + 0.3
    grid = np.empty((_CELLS, _CELLS, 3))
    grid[..., 0], grid[..., 1] = np.meshgrid(*(np.linspace(low[axis], high[axis], _CELLS) for axis in _PLAN))
    grid[..., 2] = known_quantile(ways_m[:, 2], 0.5)
    views = in_views(rig, grid.reshape(-1, 3)).sum(axis=1).astype(float).reshape(_CELLS, _CELLS)
    views[views < 1] = np.nan
    palette = [f"rgba(11, 110, 134, {0.08 + 0.5 * share:.2f})" for share in np.linspace(0, 1, rig.n_cameras)]
    mapper = models().LinearColorMapper(palette, low=0.5, high=rig.n_cameras + 0.5, nan_color="rgba(0, 0, 0, 0)")
    size = high - low
    place = {"x": low[0], "y": low[1], "dw": size[0], "dh": size[1]}
    plot.image([views.astype(np.float32)], **place, color_mapper=mapper)
    plot.add_layout(colour_bar(mapper, "cameras"), "right")


def _poses(plot: Figure, recording: FinishedRecording, axes: tuple[int, int]) -> None:
    """The main person at some moments."""
    skeleton, positions_m = recording.main.skeleton, recording.main.positions_m
    whole = np.flatnonzero(np.isfinite(positions_m).all(axis=(1, 2)))
    frames = whole[spread_evenly(len(whole), _POSES)] if len(whole) else whole
    bones = [*skeleton.bones, *skeleton.lines]
    ends = [[positions_m[frame, list(bone), axis].tolist() for frame in frames for bone in bones] for axis in axes]
    plot.multi_line(*ends, color="#0b6e86", line_width=1.5, line_alpha=0.8)


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
    of_cameras = heat_map(
        shares, trajectory.time_s, SEEN_PALETTE, whole, "seen / %", "Share of the joints that each camera sees",
        columns=columns,
    )  # fmt: skip
    caption = "Number of cameras that see each joint; fewer than two do not determine it"
    of_joints = heat_map(
        rows, trajectory.time_s, SEEN_PALETTE, limits, "cameras / ", caption, counts=True, columns=columns
    )
    everything = np.mean(seen, axis=(0, 2))
    least = int(everything.argmin())
    fewest = f"{_percent(everything[least])} or more, {trajectory.camera_names[least]} the fewest"
    said = f"{of_cameras.caption}: {'all of them' if everything[least] == 1 else fewest}"
    return [_unless_even(of_cameras, shares, said), Folded(_said_of_views(views, rows), (of_joints,))]


def _percent(share: float) -> str:
    # 99.97 % are not all.
    return f"{100 * share if share == 1 else min(100 * share, 99.9):.3g} %"


def _said_of_views(views: Float[np.ndarray, "frame joint"], rows: Mapping[str, object]) -> str:
    usual = int(np.bincount(views.astype(int).ravel()).argmax())
    is_usual = (views == usual).mean(axis=0)
    least = int(is_usual[: len(rows)].argmin())
    words = f"Number of cameras that see each joint: {usual} in {_percent(float(is_usual.mean()))} of all frames"
    return (
        words
        if np.isclose(is_usual[least], is_usual.mean())
        else f"{words}, of {list(rows)[least]} in {_percent(float(is_usual[least]))}"
    )


def _unless_even(plot: Plot, rows: Mapping[str, Float[np.ndarray, " frame"]], said: str) -> Plot | Folded:
    """Folded if nearly all of it has one colour."""
    values = np.concatenate(list(rows.values()))
    values = values[np.isfinite(values)]
    usual = np.median(values) if values.size else 0.0
    is_even = np.mean(np.abs(values - usual) <= _ONE_COLOUR * max(abs(usual), 1.0)) > _EVEN if values.size else True
    return Folded(said, (plot,)) if is_even else plot


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
    blocks: list[Block] = [_per_camera(recording, residual_px), *of_people(recording, _errors_over_time)]
    blocks += [_histogram(recording, residual_px), _per_joint(recording, residual_px)]
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
            TableCell(name), percent(float(np.isfinite(residual_px[:, c]).mean()), bad_below=0.5),
            number(medians[c], worst=4 * known_quantile(np.array(medians), 0.5)),
            number(known_quantile(residual_px[:, c], 0.9)), percent(float(np.mean(own < 0.5)) if own.size else np.nan),
        ))  # fmt: skip
    columns = ("camera", "seen", "median / px", "90 % / px", "hallucinated")
    return Table(columns, tuple(rows), "Cameras" + of_everybody(recording), hints=hints)


def _per_joint(recording: FinishedRecording, residual_px: Float[np.ndarray, "frame camera joint"]) -> Folded:
    joints = recording.main.skeleton.joints
    medians = np.array([
        [known_quantile(residual_px[:, c, j], 0.5) for c in range(residual_px.shape[1])] for j in range(len(joints))
    ])  # fmt: skip
    worst = 4 * known_quantile(medians, 0.5)
    all_cameras = np.array([known_quantile(residual_px[:, :, j], 0.5) for j in range(len(joints))])
    rows = [
        (TableCell(joint), *(number(value, worst=worst) for value in medians[j]), number(all_cameras[j]))
        for j, joint in enumerate(joints)
    ]
    caption = "px; coloured from twice the median of all on"
    table = Table(("joint", *recording.camera_names, "all"), tuple(rows), caption)
    title = f"Median reprojection error of each joint{of_everybody(recording)}"
    return Folded(f"{title}: {span_text(dict(zip(joints, all_cameras.tolist(), strict=True)), 'px')}", (table,))


def span_text(values: Mapping[str, float], unit: str) -> str:
    """The least and the largest of those that are known, and whose they are."""
    known = {name: value for name, value in values.items() if np.isfinite(value)}
    if not known:
        return "not known"
    low, high = min(known, key=lambda name: known[name]), max(known, key=lambda name: known[name])
    return f"{known[low]:.1f} {unit} ({low}) to {known[high]:.1f} {unit} ({high})"


def _histogram(recording: FinishedRecording, residual_px: Float[np.ndarray, "frame camera joint"]) -> Folded:
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
    legend_below(plot)
    whose = of_everybody(recording)
    caption = f"Distribution of the reprojection errors of each camera{whose}"
    within = f"{known_quantile(residual_px, 0.5):.1f} px, 90 % within {known_quantile(residual_px, 0.9):.1f} px"
    return Folded(f"{caption}: median {within}", (Plot(plot, f"{caption}; the last few per cent are cut off", 240),))


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
            TableCell(camera.name), TableCell(f"{camera.size_px[0]} × {camera.size_px[1]}"),
            number(float(camera.K[0, 0]), 0),
            number(x_m, 2), number(y_m, 2), number(z_m, 2), TableCell(clock, key=offset_ms),
        ))  # fmt: skip
    columns = ("camera", "image / px", "focal length / px", "x / m", "y / m", "z / m", "clock / ms")
    hints = (*6 * ("",), "time offset: how much later than its time stamps say it takes its images, ± sigma")
    blocks: list[Block] = list(plan_and_side(recording))
    blocks.append(Table(columns, tuple(rows), "Cameras in the world", hints=hints))
    if not recording.offset_sigma_s:
        blocks.append(Note("The clocks are those of the calibration; they were not estimated from this motion.", True))
    blocks += verdict(recording)
    return Section("Cameras, calibration and clocks", "cameras", blocks, short="Cameras")
