"""Cameras and the walk, from above and from the side."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.geometry.camera import Camera
from fgpose.report.blocks import Plot
from fgpose.report.finished import FinishedRecording
from fgpose.report.plots import COLOURS, gathered, plain_figure
from fgpose.report.series import known_quantile, root_m
from fgpose.report.solution_checks import views_of

_HEIGHT_PX = 420
_CELLS = 44  # of the map of the covered volume, along each side
_WAY_POINTS = 500


def plan_and_side(recording: FinishedRecording) -> tuple[Plot, Plot]:
    """Plan (x, y) with the floor that cameras see, and side view (x, z). The world's z is taken to be up."""
    plan = _view(recording, (0, 1), "y / m")
    side = _view(recording, (0, 2), "z / m")
    return (
        Plot(
            plan, "Plan: cameras, the way of the hips, and how many cameras see each place at their height", _HEIGHT_PX
        ),
        Plot(side, "Side: cameras, and where the joints were (5th to 95th centile of each)", _HEIGHT_PX // 2 + 60),
    )


def _view(recording: FinishedRecording, axes: tuple[int, int], y_label: str):  # noqa: ANN202 (a figure of Bokeh)
    from bokeh.models import HoverTool

    rig = recording.rig
    assert rig is not None
    is_plan = axes[1] == 1
    plot = plain_figure("x / m", y_label, _HEIGHT_PX if is_plan else _HEIGHT_PX // 2 + 60, match_aspect=True)
    reach_m = 0.25 * max(np.ptp([camera.position_m for camera in rig.cameras], axis=0).max(), 1.0)
    if is_plan:
        _covered(plot, recording)
    else:
        _joints(plot, recording, axes)
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
    data = {"x": places_m[:, axes[0]], "y": places_m[:, axes[1]], "name": list(rig.names)}
    dots = plot.scatter("x", "y", size=9, color="#d55e00", source=data)
    plot.text("x", "y", "name", source=data, x_offset=8, y_offset=-4, text_font_size="12px", text_color="#8a8f98")
    plot.add_tools(HoverTool(renderers=[dots], tooltips=[("", "@name"), ("", "@x{0.00} m, @y{0.00} m")]))
    plot.xgrid.grid_line_color = plot.ygrid.grid_line_color
    plot.xgrid.grid_line_alpha = 0.5
    return plot


def _frustum_m(camera: Camera, reach_m: float) -> list[Float[np.ndarray, 3]]:
    """The corners of the image at a depth, in the world."""
    width, height = camera.size_px
    corners_px = np.array([(0, 0), (width, 0), (width, height), (0, height)], dtype=float)
    rays = np.linalg.solve(camera.K, np.column_stack([corners_px, np.ones(4)]).T).T
    return list(camera.to_world_frame(rays * reach_m))


def _covered(plot, recording: FinishedRecording) -> None:  # noqa: ANN001 (a figure of Bokeh)
    """How many cameras see each place at the height of the hips."""
    from bokeh.models import ColorBar, LinearColorMapper

    rig = recording.rig
    assert rig is not None
    ways_m = np.concatenate([root_m(trajectory) for trajectory in recording.people.values()])
    places_m = np.array([camera.position_m for camera in rig.cameras])
    everything_m = np.concatenate([places_m, ways_m[np.isfinite(ways_m).all(axis=1)]])
    low, high = everything_m.min(axis=0) - 0.3, everything_m.max(axis=0) + 0.3
    x_m, y_m = (np.linspace(low[axis], high[axis], _CELLS) for axis in range(2))
    height_m = known_quantile(ways_m[:, 2], 0.5)
    grid = np.stack([*np.meshgrid(x_m, y_m), np.full((_CELLS, _CELLS), height_m)], axis=-1)
    views = views_of(grid.reshape(-1, 3), rig).reshape(_CELLS, _CELLS)
    views[views < 1] = np.nan
    palette = [f"rgba(11, 110, 134, {0.08 + 0.5 * share:.2f})" for share in np.linspace(0, 1, rig.n_cameras)]
    mapper = LinearColorMapper(palette, low=0.5, high=rig.n_cameras + 0.5, nan_color="rgba(0, 0, 0, 0)")
    place = {"x": low[0], "y": low[1], "dw": high[0] - low[0], "dh": high[1] - low[1]}
    plot.image([views.astype(np.float32)], **place, color_mapper=mapper)
    bar = ColorBar(color_mapper=mapper, title="cameras", width=10, background_fill_color=None, bar_line_color=None)
    bar.ticker.desired_num_ticks = rig.n_cameras  # pyright: ignore[reportAttributeAccessIssue, reportOptionalMemberAccess]
    plot.add_layout(bar, "right")


def _joints(plot, recording: FinishedRecording, axes: tuple[int, int]) -> None:  # noqa: ANN001 (a figure of Bokeh)
    """The box in which each joint of the main person was."""
    skeleton, positions_m = recording.main.skeleton, recording.main.positions_m
    boxes = {"left": [], "right": [], "bottom": [], "top": [], "name": []}
    for j, joint in enumerate(skeleton.joints):
        sides = [known_quantile(positions_m[:, j, axis], q) for axis in axes for q in (0.05, 0.95)]
        for key, side in zip(("left", "right", "bottom", "top"), sides, strict=True):
            boxes[key].append(side)
        boxes["name"].append(joint)
    plot.quad(source=boxes, fill_color="#0b6e86", fill_alpha=0.08, line_color="#0b6e86", line_alpha=0.25)
