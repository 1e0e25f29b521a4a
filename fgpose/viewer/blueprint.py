"""The layouts that recordings open with: of the results of one person, and of people."""

from __future__ import annotations

from collections.abc import Sequence

import rerun.blueprint as rrb

from fgpose.geometry.camera import CameraRig
from fgpose.skeleton import Skeleton
from fgpose.viewer import paths
from fgpose.viewer.layout import layout
from fgpose.viewer.session import UpAxis


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
