"""The layout that the recording of several people opens with. Views show whole trees: who will come is not known."""

from __future__ import annotations

import rerun.blueprint as rrb

from fgpose.geometry.camera import CameraRig
from fgpose.viewer import paths
from fgpose.viewer.layout import layout
from fgpose.viewer.session import UpAxis


def people_blueprint(rig: CameraRig, up: UpAxis, *, following: bool, of_system: bool = False) -> rrb.Blueprint:
    """See layout; of a live system with the states of its cameras and its delays, along capture time."""
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
