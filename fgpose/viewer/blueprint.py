"""The layout that a recording opens with."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float

from fgpose.geometry.camera import CameraRig
from fgpose.skeleton import Skeleton
from fgpose.viewer import palette, paths
from fgpose.viewer.recording import UpAxis
from fgpose.viewer.scene import viewing_distance_m, viewing_target_m

# High enough to see the floor, low enough that nobody is foreshortened.
_EYE_ELEVATION_RAD = math.radians(22)
# The eye is as far away as the cameras: those on the other side are then in view, with their pictures.
_EYE_DISTANCE_SHARE = 1.0
# A third of that in the pictures (scene.py), see _small.
_FRUSTUM_DETECTION_RADIUS = rr.Radius.ui_points(1.2)


def blueprint(
    rig: CameraRig, skeleton: Skeleton, trajectories: Sequence[str], up: UpAxis, *, following: bool
) -> rrb.Blueprint:
    """3D scene and cameras above, time series below.

    Args:
        rig: the cameras.
        skeleton: the joints.
        trajectories: names of the results, the most important last.
        up: the world axis that points up.
        following: always show the newest frame (live); otherwise begin at the first one.
    """
    images = [_image_view(name, trajectories) for name in rig.names]
    grid = rrb.Grid(contents=images, grid_columns=_image_columns(rig))
    top = rrb.Horizontal(_scene_view(rig, trajectories, up), grid, column_shares=[1, 1])
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
    return rrb.Blueprint(
        rrb.Vertical(top, plots, row_shares=[2, 1]),
        rrb.TimePanel(state="collapsed", timeline="frame", play_state="following" if following else "paused"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
        auto_layout=False,
    )


def _scene_view(rig: CameraRig, trajectories: Sequence[str], up: UpAxis) -> rrb.Spatial3DView:
    position_m, target_m = _eye(rig, up)
    return rrb.Spatial3DView(
        origin=paths.WORLD,
        name="Scene",
        background=palette.BACKGROUND,
        line_grid=rrb.LineGrid3D(visible=True, spacing=0.5, stroke_width=0.5, color=palette.GRID),
        eye_controls=rrb.EyeControls3D(position=position_m, look_target=target_m, eye_up=_up_vector(up)),
        overrides=_hidden(rig.names, trajectories) | _small(rig.names),
    )


def _small(cameras: Sequence[str]) -> dict[Any, list[rr.Points2D]]:
    """Detections in a frustum are drawn smaller than elsewhere: the picture is small there, and they would hide the
    person."""
    return {paths.detections(camera): [rr.Points2D.from_fields(radii=_FRUSTUM_DETECTION_RADIUS)] for camera in cameras}


def _image_view(camera: str, trajectories: Sequence[str]) -> rrb.Spatial2DView:
    overrides = _hidden([camera], trajectories)
    return rrb.Spatial2DView(
        origin=paths.image(camera), name=camera, background=palette.BACKGROUND, overrides=overrides
    )


def _hidden(cameras: Sequence[str], trajectories: Sequence[str]) -> dict[Any, list[rrb.EntityBehavior]]:
    """The reprojections of all results but the last: all of them together would hide the detections."""
    earlier = [paths.reprojections(camera, name) for camera in cameras for name in trajectories[:-1]]
    return {path: [rrb.EntityBehavior(visible=False)] for path in earlier}


def _image_columns(rig: CameraRig) -> int:
    """Columns of the grid of pictures: upright ones stand side by side."""
    upright = np.mean([camera.size_px[0] < camera.size_px[1] for camera in rig.cameras]) > 0.5
    return min(rig.n_cameras, 4) if upright else math.ceil(math.sqrt(rig.n_cameras))


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


def _up_vector(up: UpAxis) -> Float[np.ndarray, 3]:
    return (1.0 if up[0] == "+" else -1.0) * np.eye(3)["xyz".index(up[1])]


def _eye(rig: CameraRig, up: UpAxis) -> tuple[Float[np.ndarray, 3], Float[np.ndarray, 3]]:
    """Position and target of the eye: in the widest gap between two cameras, so that none of them hides the person."""
    vertical = _up_vector(up)
    target_m = viewing_target_m(rig)
    first = np.roll(vertical, 1)
    second = np.cross(vertical, first)
    offsets_m = np.stack([camera.position_m - target_m for camera in rig.cameras])
    azimuth = np.sort(np.arctan2(offsets_m @ second, offsets_m @ first))
    gaps = np.diff(np.append(azimuth, azimuth[0] + 2 * np.pi))
    # With one camera the gap is the whole circle, and its middle is behind the person: stand beside the camera instead.
    middle = azimuth[np.argmax(gaps)] + (gaps.max() / 2 if len(azimuth) > 1 else 0.5)
    outward = np.cos(_EYE_ELEVATION_RAD) * (np.cos(middle) * first + np.sin(middle) * second)
    outward = outward + np.sin(_EYE_ELEVATION_RAD) * vertical
    return target_m + _EYE_DISTANCE_SHARE * viewing_distance_m(rig) * outward, target_m
