"""Rerun's viewer in a notebook."""

from __future__ import annotations

import tempfile
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import ModuleType
from typing import Any

from fgpose.geometry.camera import CameraRig
from fgpose.geometry.up_axis import nearest_axis
from fgpose.kinematics.vertical import find_up
from fgpose.sampling import thinning
from fgpose.shown.wrong_types import check_type
from fgpose.trajectory import Trajectory
from fgpose.viewer import open_recording
from fgpose.viewer.onlooker import with_rig

_NAME = "trajectory"
# All that is shown is sent to the browser.
_MOST_FRAMES = 5000


def show(trajectory: Trajectory, rig: CameraRig | None, height_px: int) -> Any:
    """See Motion.show."""
    if rig is not None:
        check_type("show", "rig", rig, CameraRig)
    widgets = _widgets()
    if not trajectory.n_frames:
        raise ValueError("there is no frame to be shown")
    widget = widgets.Viewer(width="auto", height=height_px)
    widget.send_rrd(_rrd(trajectory, rig))
    return widget


def _widgets() -> ModuleType:
    """Of Rerun. Raises ImportError that says how to install it."""
    try:
        wanted = version("rerun-sdk")
    except PackageNotFoundError:
        raise ImportError("show() needs Rerun and its widget: pip install 'fgpose[notebook]'") from None
    try:
        widgets = import_module("rerun_notebook")
    except ImportError:
        raise ImportError("show() needs the notebook widget of Rerun: pip install 'fgpose[notebook]'") from None
    if version("rerun-notebook") != wanted:
        remedy = f"pip install 'rerun-notebook=={wanted}'"
        raise ImportError(f"rerun-notebook is {version('rerun-notebook')} and rerun-sdk {wanted}: {remedy}")
    return widgets


def _rrd(trajectory: Trajectory, rig: CameraRig | None) -> bytes:
    """The recording that the viewer reads."""
    world_up = find_up([trajectory], rig).world_up
    rig, people = with_rig(rig, {0: trajectory})
    every = thinning(trajectory.time_s, None, _MOST_FRAMES)
    with tempfile.TemporaryDirectory(prefix="fgpose-") as folder:
        path = Path(folder) / f"{_NAME}.rrd"
        options: dict[str, Any] = {"n_frames": trajectory.n_frames, "every": every, "up": nearest_axis(world_up)}
        with open_recording(path, rig, trajectory.skeleton, (_NAME,), **options) as recording:
            recording.log_trajectory(_NAME, people[0])
        return path.read_bytes()
