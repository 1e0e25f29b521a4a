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
from fgpose.viewer.rerun.scene import viewing_distance_m, viewing_target_m

# High enough to see the floor, low enough that nobody is foreshortened.
_EYE_ELEVATION_RAD = math.radians(22)
# The eye is as far away as the cameras: those on the other side are then in view, with their pictures.
_EYE_DISTANCE_SHARE = 1.0
# To look at the cameras themselves: far and high enough for all to be in view.
_OVERVIEW_ELEVATION_RAD = math.radians(35)
_OVERVIEW_DISTANCE_SHARE = 2.1
# A third of that in the pictures, see _small.
_FRUSTUM_DETECTION_RADIUS = rr.Radius.ui_points(1.2)

_Overrides = dict[Any, list[Any]]
"""How entities look in a view, by their paths."""


def layout(
    rig: CameraRig,
    up: UpAxis,
    plots: rrb.Horizontal,
    *,
    following: bool,
    hidden: Sequence[str] = (),
    timeline: str = "frame",
    overview: bool = False,
) -> rrb.Blueprint:
    """3D scene and cameras above, time series below.

    Args:
        rig: the cameras.
        up: the world axis that points up.
        plots: the time series.
        following: always show the newest frame (live); otherwise begin at the first one.
        hidden: paths of what the images do not show, unless it is asked for.
        timeline: along which time passes.
        overview: look at all cameras, not at the person among them.
    """
    overrides: _Overrides = {path: [rrb.EntityBehavior(visible=False)] for path in hidden}
    images = [_image_view(name, overrides) for name in rig.names]
    grid = rrb.Grid(contents=images, grid_columns=_image_columns(rig))
    top = rrb.Horizontal(_scene_view(rig, up, overrides, overview), grid, column_shares=[1, 1])
    return rrb.Blueprint(
        rrb.Vertical(top, plots, row_shares=[2, 1]),
        rrb.TimePanel(state="collapsed", timeline=timeline, play_state="following" if following else "paused"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
        auto_layout=False,
    )


def _scene_view(rig: CameraRig, up: UpAxis, overrides: _Overrides, overview: bool) -> rrb.Spatial3DView:
    position_m, target_m = _eye(rig, up, overview)
    return rrb.Spatial3DView(
        origin=paths.WORLD,
        name="Scene",
        background=palette.BACKGROUND,
        line_grid=rrb.LineGrid3D(visible=True, spacing=0.5, stroke_width=0.5, color=palette.GRID),
        eye_controls=rrb.EyeControls3D(position=position_m, look_target=target_m, eye_up=up_vector(up)),
        overrides=overrides | _small(rig.names),
    )


def _small(cameras: Sequence[str]) -> _Overrides:
    """Detections in a frustum are drawn smaller than elsewhere: the picture is small there, and they would hide the
    person."""
    return {paths.detections(camera): [rr.Points2D.from_fields(radii=_FRUSTUM_DETECTION_RADIUS)] for camera in cameras}


def _image_view(camera: str, overrides: _Overrides) -> rrb.Spatial2DView:
    own = {path: looks for path, looks in overrides.items() if path.startswith(f"{paths.image(camera)}/")}
    return rrb.Spatial2DView(origin=paths.image(camera), name=camera, background=palette.BACKGROUND, overrides=own)


def _image_columns(rig: CameraRig) -> int:
    """Columns of the grid of pictures: upright ones stand side by side."""
    upright = np.mean([camera.size_px[0] < camera.size_px[1] for camera in rig.cameras]) > 0.5
    return min(rig.n_cameras, 4) if upright else math.ceil(math.sqrt(rig.n_cameras))


def _eye(rig: CameraRig, up: UpAxis, overview: bool) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]:
    """Position and target of the eye: in the widest gap between two cameras, so that none of them hides the person."""
    vertical = up_vector(up)
    target_m = viewing_target_m(rig)
    first = np.roll(vertical, 1)
    second = np.cross(vertical, first)
    offsets_m = np.stack([camera.position_m - target_m for camera in rig.cameras])
    azimuth = np.sort(np.arctan2(offsets_m @ second, offsets_m @ first))
    gaps = np.diff(np.append(azimuth, azimuth[0] + 2 * np.pi))
    # With one camera the gap is the whole circle, and its middle is behind the person: stand beside the camera instead.
    middle = azimuth[np.argmax(gaps)] + (gaps.max() / 2 if len(azimuth) > 1 else 0.5)
    elevation = _OVERVIEW_ELEVATION_RAD if overview else _EYE_ELEVATION_RAD
    share = _OVERVIEW_DISTANCE_SHARE if overview else _EYE_DISTANCE_SHARE
    outward = np.cos(elevation) * (np.cos(middle) * first + np.sin(middle) * second) + np.sin(elevation) * vertical
    return target_m + share * viewing_distance_m(rig) * outward, target_m


def blueprint(
    rig: CameraRig, skeleton: Skeleton, trajectories: Sequence[str], up: UpAxis, *, following: bool
) -> rrb.Blueprint:
    """The layout of the recording of one person.

    Args:
        rig: the cameras.
        skeleton: the joints.
        trajectories: names of the results, the most important last.
        up: the world axis that points up.
        following: always show the newest frame (live); otherwise begin at the first one.
    """
    plots = rrb.Horizontal(
        _first_last("Reprojection error [px]", paths.REPROJECTION_PX, trajectories),
        _first_last("Bone lengths [m]", paths.BONE_LENGTH, trajectories),
        rrb.Tabs(
            rrb.TimeSeriesView(origin=paths.WEIGHT, name="Weights of the views"),
            _status_view(trajectories[-1]),
            rrb.TextDocumentView(origin=paths.RESIDUAL_TABLE, name="Residuals [sigmas]"),
            _residual_views(skeleton),
            rrb.TimeSeriesView(origin=paths.UPDATE_MS, name="Update [ms]"),
        ),
    )
    # All of them together would hide the detections.
    earlier = [paths.reprojections(camera, name) for camera in rig.names for name in trajectories[:-1]]
    return layout(rig, up, plots, following=following, hidden=earlier)


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
    plots = [
        rrb.TimeSeriesView(origin=paths.REPROJECTION_PX, name="Reprojection error [px]"),
        rrb.TimeSeriesView(origin=paths.N_PEOPLE, name="People"),
        rrb.TimeSeriesView(origin=paths.UNUSED, name="Nobody's detections"),
        rrb.StateTimelineView(origin=paths.STATUS, name="Missing joints"),
    ]
    states = [rrb.StateTimelineView(origin=paths.TRACKS, name="Tracks")]
    if of_system:
        states.append(rrb.StateTimelineView(origin=paths.CAMERA_STATES, name="Cameras"))
        delays = rrb.TimeSeriesView(origin=paths.DELAY_MS, name="From image to frame [ms]")
        plots = [delays, *plots, rrb.TimeSeriesView(origin=paths.OBSERVED, name="Observed [%]")]
    below = rrb.Horizontal(rrb.Vertical(*states) if of_system else states[0], events, rrb.Tabs(*plots))
    return layout(rig, up, below, following=following, timeline=timeline)


def _first_last(name: str, origin: str, trajectories: Sequence[str]) -> rrb.Tabs:
    """One tab per result, the last of them in front."""
    views = [
        rrb.TimeSeriesView(origin=paths.join(origin, trajectory), name=f"{name} {trajectory}")
        for trajectory in reversed(trajectories)
    ]
    return rrb.Tabs(*views, active_tab=0)


def _status_view(trajectory: str) -> rrb.StateTimelineView:
    return rrb.StateTimelineView(origin=paths.join(paths.STATUS, trajectory), name=f"Missing joints {trajectory}")


def _residual_views(skeleton: Skeleton) -> rrb.Tabs:
    joints = [skeleton.joints[joint] for joint in paths.limb_joints(skeleton)]
    views = [rrb.TimeSeriesView(origin=paths.join(paths.RESIDUAL, joint), name=joint) for joint in joints]
    return rrb.Tabs(*views, name="Residuals by joint")


def calibration_blueprint(rig: CameraRig, up: UpAxis) -> rrb.Blueprint:
    """3D scene and cameras above; below the verdict, the reprojection errors and the epipolar distances.

    Args:
        rig: the cameras.
        up: the world axis that points up.
    """
    epipolar = [
        rrb.TimeSeriesView(origin=paths.join(paths.EPIPOLAR_PX, camera), name=f"Epipolar [px] {camera}")
        for camera in rig.names
    ]
    plots = rrb.Horizontal(
        rrb.TextDocumentView(origin=paths.REPORT, name="Verdict"),
        rrb.TimeSeriesView(origin=paths.join(paths.REPROJECTION_PX, WALK), name="Reprojection error [px]"),
        rrb.Tabs(*epipolar, name="Epipolar distance [px]", active_tab=0),
    )
    return layout(rig, up, plots, following=False, overview=True)
