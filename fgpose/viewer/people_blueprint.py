"""The layout that the recording of several people opens with. Views show whole trees: who will come is not known."""

from __future__ import annotations

import rerun.blueprint as rrb

from fgpose.geometry.camera import CameraRig
from fgpose.viewer import paths
from fgpose.viewer.layout import layout
from fgpose.viewer.session import UpAxis


def people_blueprint(rig: CameraRig, up: UpAxis, *, following: bool) -> rrb.Blueprint:
    """See layout."""
    events = rrb.TextLogView(
        origin=paths.EVENTS,
        name="Events",
        columns=rrb.TextLogColumns(timeline_columns=["frame"], text_log_columns=["body"]),
        format_options=rrb.TextLogFormat(monospace_body=False),
    )
    plots = rrb.Horizontal(
        rrb.StateTimelineView(origin=paths.TRACKS, name="Tracks"),
        events,
        rrb.Tabs(
            rrb.TimeSeriesView(origin=paths.REPROJECTION_PX, name="Reprojection error [px]"),
            rrb.TimeSeriesView(origin=paths.N_PEOPLE, name="People"),
            rrb.TimeSeriesView(origin=paths.UNUSED, name="Nobody's detections"),
            rrb.StateTimelineView(origin=paths.STATUS, name="Missing joints"),
        ),
    )
    return layout(rig, up, plots, following=following)
