"""Opening the viewer on a recording or on a result."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from tyro.conf import Positional, arg

from fgpose.cli.options import new_console

if TYPE_CHECKING:
    from fgpose.geometry.camera import CameraRig
    from fgpose.trajectory import Trajectory

_RRD_START = b"RRF"


@dataclass(frozen=True, kw_only=True)
class View:
    """Open the Rerun viewer on a .rrd file or on a result (parquet, npz, TRC, C3D).

    Example: fgpose view out/demo.rrd
    """

    file: Positional[Path]
    """A .rrd file, or a trajectory file in any of the formats that fgpose writes."""
    web: bool = False
    """Show it in a browser instead of a window of its own. Ctrl-C ends."""
    rig: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="(default: none)")] = None
    """Calibration of the cameras, to be shown with a trajectory file."""
    world_up: Literal["z", "y"] = "z"
    """Axis of the world that points up, for a trajectory file."""

    def run(self) -> None:
        with self.file.open("rb") as file:
            is_rrd = file.read(len(_RRD_START)) == _RRD_START
        if is_rrd:
            self._open(self.file)
            return
        with tempfile.TemporaryDirectory(prefix="fgpose-") as folder:
            self._open(self._made_rrd(Path(folder)))

    def _made_rrd(self, folder: Path) -> Path:
        """A .rrd file of a trajectory file."""
        from fgpose.io.calibration import load_rig
        from fgpose.io.trajectories import load_trajectory
        from fgpose.pipeline import Outputs

        trajectory = load_trajectory(self.file, world_up=self.world_up)
        if self.rig is None:
            rig = onlooker(trajectory)
            trajectory = replace(trajectory, residual_px=None, visibility=None, camera_names=())
        else:
            rig = load_rig(self.rig)
            if trajectory.camera_names and trajectory.camera_names != rig.names:
                rig = rig.subset(trajectory.camera_names)
        outputs = Outputs(folder, self.file.stem, ("rrd",), self.world_up)
        with outputs.open_viewer(rig, trajectory.skeleton, (self.file.stem,)) as recording:
            recording.log_trajectory(self.file.stem, trajectory)
        return outputs.path("rrd")

    def _open(self, path: Path) -> None:
        if not self.web and not _has_display():
            raise OSError(
                f"no display to open a window on. In a browser: fgpose view {self.file} --web. "
                "Or copy the .rrd file to a computer with a display and open it there with rerun"
            )
        command = [_rerun(), str(path), *(["--web-viewer"] if self.web else [])]
        new_console(stderr=True).print(" ".join(command), soft_wrap=True)
        code = subprocess.run(command, check=False).returncode
        if code:
            raise OSError(f"the viewer ended with code {code}")


def onlooker(trajectory: Trajectory) -> CameraRig:
    """A camera that looks at the person from the side. The viewer needs one, and no calibration was given."""
    from fgpose.geometry.camera import Camera, CameraRig

    known = trajectory.positions_m[np.isfinite(trajectory.positions_m).all(axis=-1)]
    target_m = np.median(known, axis=0) if len(known) else np.zeros(3)
    K = np.array([[1000.0, 0.0, 500.0], [0.0, 1000.0, 500.0], [0.0, 0.0, 1.0]])
    world_T_camera = np.eye(4)
    world_T_camera[:3, :3] = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    world_T_camera[:3, 3] = target_m - [0.0, 4.0, 0.0]
    return CameraRig((Camera("no calibration", (1000, 1000), K, world_T_camera, np.zeros(0)),))


def _rerun() -> str:
    """The viewer's program: that beside this Python, else the one on the path."""
    beside = shutil.which("rerun", path=str(Path(sys.executable).parent))
    program = beside or shutil.which("rerun")
    if program is None:
        raise ImportError("the viewer needs Rerun: pip install 'fgpose[viewer]'")
    return program


def _has_display() -> bool:
    return sys.platform != "linux" or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
