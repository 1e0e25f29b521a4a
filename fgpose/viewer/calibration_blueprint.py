"""The layout that the recording of a calibration opens with."""

from __future__ import annotations

import rerun.blueprint as rrb

from fgpose.geometry.camera import CameraRig
from fgpose.viewer import paths
from fgpose.viewer.calibration_recording import WALK
from fgpose.viewer.layout import layout
from fgpose.viewer.session import UpAxis


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
