"""The layouts that recordings open with."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float

from fgpose.geometry.camera import CameraRig
from fgpose.geometry.up_axis import UpAxis, up_vector
from fgpose.skeleton import Skeleton
from fgpose.viewer.recording import WALK
from fgpose.viewer.rerun import palette, paths
from fgpose.viewer.rerun.scene import viewing_target_m

# High enough to see the floor, low enough that nobody is foreshortened.
_EYE_ELEVATION_RAD = math.radians(20)
# To look at the cameras themselves.
_OVERVIEW_ELEVATION_RAD = math.radians(35)
# Half of what the eye sees, across and up, with room for the names of cameras: Rerun sees 55 degrees from top to
# bottom, and the scene is half as wide again as it is high.
_HALF_VIEW = (math.tan(math.radians(34)), math.tan(math.radians(22)))
# Nearer than the cameras it is among the people.
_LEAST_EYE_DISTANCE = 1.0
# Gaps between cameras that are nearly as wide as the widest are looked through as well.
_WIDE_GAP = 0.7
# A third of that in the pictures, see _small.
_FRUSTUM_DETECTION_RADIUS = rr.Radius.ui_points(1.2)
# The room for all pictures in a usual window, and what the title of each takes of it. With more columns names are cut.
_PICTURES_PX, _TITLE_PX, _MOST_COLUMNS = (560, 480), 24, 3
# More names are not told apart in a column beside a plot: then it has a legend of its own.
_LEGEND_ROOM, _LEAST_LEGEND_ROOM = 10, 4

_Overrides = dict[Any, list[Any]]
"""How entities look in a view, by their paths."""
_Eye = tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]
"""Its position and its target, metres."""


def _layout(
    tops: Sequence[rrb.Container], plots: rrb.Container, *, following: bool, timeline: str = "frame"
) -> rrb.Blueprint:
    """Scene and pictures above, time series below.

    Args:
        tops: scenes with pictures, of which one is shown.
        plots: the time series.
        following: always show the newest frame (live); otherwise begin at the first one.
        timeline: along which time passes.
    """
    top = tops[0] if len(tops) == 1 else rrb.Tabs(*tops, active_tab=0)
    return rrb.Blueprint(
        rrb.Vertical(top, plots, row_shares=[2, 1]),
        rrb.TimePanel(state="collapsed", timeline=timeline, play_state="following" if following else "paused"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
        auto_layout=False,
    )


def _top(
    rig: CameraRig,
    up: UpAxis,
    *,
    name: str = "",
    left_out: Sequence[str] = (),
    eye: _Eye | None = None,
) -> rrb.Horizontal:
    """The scene beside the pictures.

    Args:
        rig: the cameras.
        up: the world axis that points up.
        name: of what is shown.
        left_out: paths of what is not.
        eye: from where the scene is looked at; None: as eye_m says.
    """
    grid = rrb.Grid(contents=[_image_view(camera, left_out) for camera in rig.names], grid_columns=_image_columns(rig))
    return rrb.Horizontal(
        _scene_view(rig, up, left_out, eye or eye_m(rig, up)), grid, column_shares=[3, 2], name=name or None
    )


def _contents(left_out: Sequence[str]) -> list[str]:
    return ["$origin/**", *(f"- /{path}/**" for path in left_out)]


def _scene_view(rig: CameraRig, up: UpAxis, left_out: Sequence[str], eye: _Eye) -> rrb.Spatial3DView:
    position_m, target_m = eye
    return rrb.Spatial3DView(
        origin=paths.WORLD,
        contents=_contents(left_out),
        name="Scene",
        background=palette.BACKGROUND,
        line_grid=rrb.LineGrid3D(visible=True, spacing=0.5, stroke_width=0.5, color=palette.GRID),
        eye_controls=rrb.EyeControls3D(position=position_m, look_target=target_m, eye_up=up_vector(up)),
        overrides=_small(rig.names),
    )


def _small(cameras: Sequence[str]) -> _Overrides:
    """Detections in a frustum are drawn smaller than elsewhere: the picture is small there, and they would hide the
    person."""
    return {paths.detections(camera): [rr.Points2D.from_fields(radii=_FRUSTUM_DETECTION_RADIUS)] for camera in cameras}


def _image_view(camera: str, left_out: Sequence[str]) -> rrb.Spatial2DView:
    own = [path for path in left_out if path.startswith(f"{paths.image(camera)}/")]
    return rrb.Spatial2DView(
        origin=paths.image(camera), contents=_contents(own), name=camera, background=palette.BACKGROUND
    )


def _image_columns(rig: CameraRig) -> int:
    """Columns of the grid in which the pictures are largest, and their names can be read."""
    aspect = float(np.median([camera.size_px[0] / camera.size_px[1] for camera in rig.cameras]))
    width_px, height_px = _PICTURES_PX

    def picture_height_px(columns: int) -> float:
        rows = math.ceil(rig.n_cameras / columns)
        return min(width_px / columns / aspect, height_px / rows - _TITLE_PX)

    return max(range(1, min(rig.n_cameras, _MOST_COLUMNS) + 1), key=picture_height_px)


def eye_m(
    rig: CameraRig, up: UpAxis, *, overview: bool = False, around_m: Float[np.ndarray, " 3"] | None = None
) -> _Eye:
    """Position and target of the eye: between two cameras, so that none of them hides the person, where the gap is wide
    and all cameras are seen from near by.

    Args:
        rig: the cameras.
        up: the world axis that points up.
        overview: look at all cameras from above.
        around_m: where what they saw was, as of viewing_target_m.
    """
    vertical = up_vector(up)
    target_m = viewing_target_m(rig, around_m)
    first = np.roll(vertical, 1)
    second = np.cross(vertical, first)
    offsets_m = rig.positions_m - target_m
    azimuth = np.sort(np.arctan2(offsets_m @ second, offsets_m @ first))
    gaps = np.diff(np.append(azimuth, azimuth[0] + 2 * np.pi))
    # With one camera the gap is the whole circle, and its middle is behind the person: stand beside the camera instead.
    middles = azimuth + (gaps / 2 if len(azimuth) > 1 else 0.5)
    elevation = _OVERVIEW_ELEVATION_RAD if overview else _EYE_ELEVATION_RAD
    wide = middles[gaps >= _WIDE_GAP * gaps.max()]
    ways = [
        np.cos(elevation) * (np.cos(middle) * first + np.sin(middle) * second) + np.sin(elevation) * vertical
        for middle in wide.tolist()
    ]
    distances_m = [_least_distance_m(rig, target_m, way, vertical) for way in ways]
    nearest = int(np.argmin(distances_m))
    return target_m + distances_m[nearest] * ways[nearest], target_m


def _least_distance_m(
    rig: CameraRig, target_m: Float[np.ndarray, " 3"], outward: Float[np.ndarray, " 3"], vertical: np.ndarray
) -> float:
    """From which the eye that looks at the target has all cameras in view."""
    across = np.cross(vertical, outward) / np.linalg.norm(np.cross(vertical, outward))
    offsets_m = rig.positions_m - target_m
    beside_m = np.abs(np.stack([offsets_m @ across, offsets_m @ np.cross(outward, across)]))
    # As far before the target as a camera is, and as much further as it needs to be in view.
    needed_m = offsets_m @ outward + (beside_m / np.array(_HALF_VIEW)[:, None]).max(axis=0)
    return max(float(needed_m.max()), _LEAST_EYE_DISTANCE * float(np.linalg.norm(offsets_m, axis=1).mean()))


def blueprint(
    rig: CameraRig, skeleton: Skeleton, trajectories: Sequence[str], up: UpAxis, *, following: bool
) -> rrb.Blueprint:
    """The layout of the recording of one person: the most important result, and behind tabs each of the others with it.

    Args:
        rig: the cameras.
        skeleton: the joints.
        trajectories: names of the results, the most important last.
        up: the world axis that points up.
        following: always show the newest frame (live); otherwise begin at the first one.
    """
    *others, last = trajectories
    apart = {f"{last} and {name}": _paths_of(rig, name) for name in reversed(others)}
    apart[f"{last} and the 3D of each view"] = [paths.VIEWS]
    tops = [
        _top(rig, up, name=name, left_out=[path for other, own in apart.items() if other != name for path in own])
        for name in (last, *apart)
    ]
    limbs = 2 * len(paths.limb_names(skeleton))
    plots = rrb.Horizontal(
        _beside_legend(_first_last("Reprojection error [px]", paths.REPROJECTION_PX, trajectories, rig.n_cameras),
                       paths.CAMERA_LEGEND, rig.n_cameras),
        _beside_legend(_first_last("Bone lengths [m]", paths.BONE_LENGTH, trajectories, limbs),
                       paths.LIMB_LEGEND, limbs),
        rrb.Tabs(
            _beside_legend(_plot("Weights of the views", paths.WEIGHT, rig.n_cameras), paths.CAMERA_LEGEND,
                           rig.n_cameras, "Weights of the views"),
            _status_view(trajectories[-1]),
            rrb.TextDocumentView(origin=paths.RESIDUAL_TABLE, name="Residuals [sigmas]"),
            _residual_views(skeleton),
            _plot("Update [ms]", paths.UPDATE_MS, 1),
            active_tab=0,
        ),
    )  # fmt: skip
    return _layout(tops, plots, following=following)


def _paths_of(rig: CameraRig, trajectory: str) -> list[str]:
    """Where a result is in the scene and in the pictures."""
    return [paths.trajectory(trajectory), *(paths.reprojections(camera, trajectory) for camera in rig.names)]


def _plot(name: str, origin: str, n_lines: int) -> rrb.TimeSeriesView:
    """With a legend only if its lines are too many for one beside it: Rerun's is over them."""
    return rrb.TimeSeriesView(origin=origin, name=name, plot_legend=rrb.PlotLegend(visible=n_lines > _LEGEND_ROOM))


def _beside_legend(plot: rrb.View | rrb.Container, legend: str, n_lines: int, name: str = "") -> Any:
    """A plot, or some of the same lines, with their names in their colours beside it."""
    if n_lines > _LEGEND_ROOM:
        return plot
    names = rrb.Spatial2DView(
        origin=legend,
        name="Legend",
        titlebar=False,
        background=palette.BACKGROUND,
        visual_bounds=rrb.VisualBounds2D(x_range=(-0.05, 0.05), y_range=(-0.6, max(n_lines, _LEAST_LEGEND_ROOM) - 0.1)),
    )
    return rrb.Horizontal(plot, names, column_shares=[4, 1], name=name or None)


def people_blueprint(rig: CameraRig, up: UpAxis, *, following: bool, of_system: bool = False) -> rrb.Blueprint:
    """The layout of the recording of people, of whom it is not known who will come: views show whole trees. Of a live
    system with the states of its cameras and its delays, along capture time."""
    timeline = "time" if of_system else "frame"
    events = rrb.TextLogView(
        origin=paths.EVENTS,
        name="Events",
        columns=rrb.TextLogColumns(timeline_columns=[timeline], text_log_columns=["body"]),
        format_options=rrb.TextLogFormat(monospace_body=False),
    )
    # The tracks beside them have the colours of the people, and their names.
    plots = [
        _plot("Reprojection error [px]", paths.REPROJECTION_PX, 1),
        _plot("People", paths.N_PEOPLE, 1),
        _beside_legend(_plot("Nobody's detections", paths.UNUSED, rig.n_cameras), paths.CAMERA_LEGEND, rig.n_cameras,
                       "Nobody's detections"),
        rrb.StateTimelineView(origin=paths.STATUS, name="Missing joints"),
    ]  # fmt: skip
    states = [rrb.StateTimelineView(origin=paths.TRACKS, name="Tracks")]
    if of_system:
        states.append(rrb.StateTimelineView(origin=paths.CAMERA_STATES, name="Cameras"))
        delays = _plot("From image to frame [ms]", paths.DELAY_MS, 1)
        plots = [delays, *plots, _plot("Observed [%]", paths.OBSERVED, 1)]
    tabs = rrb.Tabs(*plots, active_tab=0)
    below = rrb.Horizontal(rrb.Vertical(*states) if of_system else states[0], events, tabs)
    # The beginning of a system is empty: it opens on what was seen last.
    return _layout([_top(rig, up)], below, following=following or of_system, timeline=timeline)


def _first_last(name: str, origin: str, trajectories: Sequence[str], n_lines: int) -> rrb.Tabs:
    """One tab per result, the last of them in front."""
    views = [
        _plot(f"{name} {trajectory}", paths.join(origin, trajectory), n_lines) for trajectory in reversed(trajectories)
    ]
    return rrb.Tabs(*views, active_tab=0)


def _status_view(trajectory: str) -> rrb.StateTimelineView:
    return rrb.StateTimelineView(origin=paths.join(paths.STATUS, trajectory), name=f"Missing joints {trajectory}")


def _residual_views(skeleton: Skeleton) -> rrb.Tabs:
    joints = [skeleton.joints[joint] for joint in paths.limb_joints(skeleton)]
    views = [rrb.TimeSeriesView(origin=paths.join(paths.RESIDUAL, joint), name=joint) for joint in joints]
    return rrb.Tabs(*views, name="Residuals by joint")


def calibration_blueprint(rig: CameraRig, up: UpAxis, around_m: Float[np.ndarray, " 3"] | None = None) -> rrb.Blueprint:
    """3D scene and cameras above; below the verdict, the reprojection errors and the epipolar distances.

    Args:
        rig: the cameras.
        up: the world axis that points up.
        around_m: where what they saw was, as of viewing_target_m.
    """
    epipolar = [
        _plot(f"Epipolar [px] {camera}", paths.join(paths.EPIPOLAR_PX, camera), rig.n_cameras) for camera in rig.names
    ]
    plots = rrb.Horizontal(
        rrb.TextDocumentView(origin=paths.REPORT, name="Verdict"),
        _plot("Reprojection error [px]", paths.join(paths.REPROJECTION_PX, WALK), rig.n_cameras),
        _beside_legend(rrb.Tabs(*epipolar, active_tab=0), paths.CAMERA_LEGEND, rig.n_cameras),
        column_shares=[3, 3, 4],
    )
    return _layout(
        [_top(rig, up, left_out=[paths.VIEWS], eye=eye_m(rig, up, overview=True, around_m=around_m))],
        plots,
        following=False,
    )
