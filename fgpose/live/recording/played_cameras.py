"""Recorded videos in place of cameras, for demonstrations: over RTSP where a server is installed, else as files."""

from __future__ import annotations

import shutil
import subprocess
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from fgpose.geometry.camera import CameraRig
from fgpose.geometry.fitted_camera import fitted_camera
from fgpose.io.calibration import load_rig, save_rig
from fgpose.live.sources.looped_video import write_looped_video

RTSP_PACKAGES = "gir1.2-gst-rtsp-server-1.0 gstreamer1.0-plugins-good gstreamer1.0-plugins-bad python3-gi"
"""Of Debian and Ubuntu, that the server needs."""

_CALIBRATION = "calibration.toml"
# GStreamer's bindings belong to the Python of the system.
_SYSTEM_PYTHON = shutil.which("python3", path="/usr/bin")


@dataclass(frozen=True)
class PlayedCameras:
    """Cameras that run."""

    rig_file: Path
    is_rtsp: bool
    """Otherwise the files are read, in real time."""


@dataclass(frozen=True)
class Served:
    """A server of videos over RTSP, in a process of its own."""

    port: int
    process_id: int

    def address(self, path: Path) -> str:
        """Of one of its files."""
        return f"rtsp://127.0.0.1:{self.port}/{path.stem}"


@contextmanager
def played_cameras(
    videos: Mapping[str, Path],
    calibration: Path,
    folder: Path,
    *,
    every: int = 1,
    shrink: int = 1,
    progress: Callable[[str], None] = lambda what: None,
) -> Iterator[PlayedCameras]:
    """Play videos as cameras, forwards and backwards and without an end.

    Args:
        videos: by the names of the cameras.
        calibration: of them.
        folder: for what is written, the rig file among it.
        every: use every so manieth image.
        shrink: make images so many times smaller.
        progress: told what is done next.

    Warns:
        UserWarning: the size of the images differs from the calibration's in a way that can be explained.

    Raises:
        ValueError: the calibration is damaged, or is not of these videos.
        OSError: a file cannot be read or written.
    """
    cameras, played = [], {name: folder / f"{name}.mp4" for name in videos}
    for camera in load_rig(calibration).subset(videos).cameras:
        progress(f"{camera.name}: preparing its video")
        video = videos[camera.name]
        before_px, size_px = write_looped_video(video, played[camera.name], every=every, shrink=shrink)
        camera = fitted_camera(camera, before_px, video)
        with warnings.catch_warnings(action="ignore"):
            cameras.append(fitted_camera(camera, size_px, video))
    save_rig(CameraRig(tuple(cameras)), folder / _CALIBRATION)
    with served(list(played.values())) as server:
        rig_file = folder / "rig.toml"
        tables = [
            f'[cameras.{name}]\nsource = "{path}"\nloop = true\n'
            if server is None
            else f'[cameras.{name}]\nsource = "{server.address(path)}"\n'
            for name, path in played.items()
        ]
        rig_file.write_text(f'[live]\ncalibration = "{_CALIBRATION}"\n\n' + "\n".join(tables))
        yield PlayedCameras(rig_file, server is not None)


@contextmanager
def served(paths: Sequence[Path]) -> Iterator[Served | None]:
    """Serve H.264 files over RTSP, each as a camera that has run all along, again and again and in step; None where
    GStreamer's server is not installed."""
    if _SYSTEM_PYTHON is None:
        yield None
        return
    command = [_SYSTEM_PYTHON, str(Path(__file__).with_name("rtsp_program.py")), *map(str, paths)]
    # In a session of its own: Ctrl-C is for the live system.
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, start_new_session=True
    ) as process:
        try:
            assert process.stdout is not None
            port = process.stdout.readline().strip()
            yield Served(int(port), process.pid) if port else None
        finally:
            process.kill()
