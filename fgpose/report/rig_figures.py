"""Cameras and the walk, from above and from the side."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.diagnosis.finished import FinishedRecording
from fgpose.diagnosis.series import known_quantile, root_m
from fgpose.diagnosis.solution_checks import views_of
from fgpose.geometry.camera import Camera
from fgpose.report.blocks import Plot
from fgpose.report.plots import COLOURS, Figure, colour_bar, gathered, models, plain_figure
from fgpose.sampling import spread_evenly

_HEIGHT_PX = 420
_PLAN = (0, 1)  # axes of the floor
_CELLS = 44  # of the map of the covered volume, along each side
_WAY_POINTS = 500
_POSES = 5
_NAME_COLOUR = "#7a808a"  # seen on white and on the ground of the dark page alike


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
    reach_m = 0.25 * max(np.ptp([camera.position_m for camera in rig.cameras], axis=0).max(), 1.0)
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
    places_m = np.array([camera.position_m for camera in rig.cameras])
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


def _frustum_m(camera: Camera, reach_m: float) -> list[Float[np.ndarray, 3]]:
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
    places_m = np.array([camera.position_m for camera in rig.cameras])
    everything_m = np.concatenate([places_m, ways_m[np.isfinite(ways_m).all(axis=1)]])
    low, high = everything_m.min(axis=0) - 0.3, everything_m.max(axis=0) + 0.3
    grid = np.empty((_CELLS, _CELLS, 3))
    grid[..., 0], grid[..., 1] = np.meshgrid(*(np.linspace(low[axis], high[axis], _CELLS) for axis in _PLAN))
    grid[..., 2] = known_quantile(ways_m[:, 2], 0.5)
    views = views_of(grid.reshape(-1, 3), rig).reshape(_CELLS, _CELLS)
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
