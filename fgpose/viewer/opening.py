"""Opening a recording; imports Rerun only if something will be shown."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from fgpose.geometry.camera import CameraRig
from fgpose.geometry.up_axis import UpAxis
from fgpose.skeleton import Skeleton
from fgpose.viewer.pictures import PictureOptions
from fgpose.viewer.recording import CalibrationRecording, Recording, SystemRecording

# Kept for viewers who connect late. 20,000 frames of 8 people in 8 cameras take half of it; of a system some minutes.
_RESULTS_MB, _PEOPLE_MB, _SYSTEM_MB = 256.0, 1024.0, 128.0


def quieten_rerun() -> None:
    """Errors only, unless RUST_LOG says otherwise: where Rerun listens is what fgpose says."""
    os.environ.setdefault("RUST_LOG", "error")


def leave_out_analytics() -> None:
    """Rerun, in this process and in those that it starts, sends nothing unless FORCE_RERUN_ANALYTICS=1 is set.

    Its own switch is a file in the user's home, which is not ours to write, and is on where nobody was asked. It sends
    nothing either where CI is set, as machines that run tests do.
    """
    os.environ.setdefault("CI", "1")


def open_recording(
    path: str | Path | None,
    rig: CameraRig,
    skeleton: Skeleton,
    trajectories: Sequence[str] | None = ("fused", "refined", "smoothed"),
    *,
    live: bool = False,
    port: int = 9876,
    endless: bool = False,
    up: UpAxis = "+z",
    image_width_px: int | None = 640,
    jpeg_quality: int = 80,
    image_limit_mb: float | None = 1000.0,
    n_frames: int | None = None,
    every: int = 1,
    images_every: int | None = None,
    made_by: str = "",
) -> Recording:
    """Open a recording with its cameras, skeleton and layout; close it, or use it in a ``with`` block.

    Args:
        path: the .rrd file (https://rerun.io), which appears under this name when it is closed; None: no file.
        rig: the cameras.
        skeleton: the joints.
        trajectories: names of the results of one person that will be compared, the most important last: its errors are
            plotted first. None: people are shown, who need not be known yet.
        live: also serve viewers of this computer, however late they connect.
        port: where they connect; 0 takes any free one, see ``viewer_url``.
        endless: for runs of many hours: memory stays constant, and seeking in the file gets slower.
        up: the world axis that points up.
        image_width_px: wider pictures are shrunk by the smallest whole factor that makes them fit; None: never. Points
            stay in the pixels of the calibration.
        jpeg_quality: of the pictures, 1 to 100.
        image_limit_mb: of all pictures together, in the file and, live, in the memory that is kept for viewers that
            connect late; None: no limit, and live the oldest frames are dropped, results and pictures alike.
        n_frames: how many frames the recording will have. When their pictures exceed the limit they are thinned out
            evenly. None: not known; the pictures end at the limit.
        every: one frame in so many is shown: files of long recordings stay small. The name in the viewer says so.
        images_every: one picture in so many frames is shown; None: that of every frame that is.
        made_by: command of fgpose, which the file then says.

    Returns:
        A recording; one that shows nothing when there is neither a path nor live.

    Raises:
        ValueError: the names of the results are repeated, reserved or absent, or an option is out of its range.
        ImportError: Rerun is not installed; the message says how to.
        OSError: the file cannot be written, or the port is taken.
    """
    if trajectories is not None and _are_no_names(trajectories):
        raise ValueError(f"results need different names, none of them camera or views; got {', '.join(trajectories)}")
    pictures = PictureOptions(image_width_px, jpeg_quality, image_limit_mb, n_frames, every, images_every)
    if path is None and not live:
        return Recording()
    with _rerun_needed():
        from fgpose.viewer.rerun.recording import RerunRecording
        from fgpose.viewer.rerun.session import Target
    server_mb = _PEOPLE_MB if trajectories is None else _RESULTS_MB
    target = Target(None if path is None else Path(path), port if live else None, endless, made_by, server_mb, every)
    return RerunRecording(target, (rig, skeleton, tuple(trajectories or ())), up, pictures)


def _are_no_names(trajectories: Sequence[str]) -> bool:
    """Of results: each has a place of its own beside the cameras and the views."""
    return (
        not trajectories or len(set(trajectories)) != len(trajectories) or bool({"camera", "views"} & {*trajectories})
    )


def open_people_recording(path: str | Path | None, rig: CameraRig, skeleton: Skeleton, **options: Any) -> Recording:
    """Open a recording of people, who need not be known yet: open_recording, which says what the options are, without
    results to compare."""
    return open_recording(path, rig, skeleton, None, **options)


def open_calibration_recording(
    path: str | Path | None,
    rig: CameraRig,
    skeleton: Skeleton,
    *,
    n_frames: int | None = None,
) -> CalibrationRecording:
    """Open a recording of a calibration from people; close it, or use it in a ``with`` block.

    Args:
        path: as are the others, as in open_recording.

    Returns:
        A recording; one that shows nothing when there is no path.

    Raises:
        ValueError: an option is out of its range.
        ImportError: Rerun is not installed; the message says how to.
        OSError: the file cannot be written.
    """
    if path is None:
        return CalibrationRecording()
    with _rerun_needed():
        from fgpose.viewer.rerun.calibration import RerunCalibrationRecording
        from fgpose.viewer.rerun.session import Target
    pictures = PictureOptions(640, 80, 1000.0, n_frames)
    return RerunCalibrationRecording(Target(Path(path), None, endless=False), rig, skeleton, "+z", pictures)


def open_system_recording(
    path: str | Path | None,
    rig: CameraRig,
    skeleton: Skeleton,
    *,
    live: bool = False,
    port: int = 9876,
    up: UpAxis = "+z",
) -> SystemRecording:
    """Open a recording of a live system, for as long as it runs: memory stays constant. Its times are Unix times.

    Args:
        path: as are the others, as in open_recording.

    Returns:
        A recording; one that shows nothing when there is neither a path nor live.

    Raises:
        ImportError: Rerun is not installed; the message says how to.
        OSError: the file cannot be written, or the port is taken.
    """
    if path is None and not live:
        return SystemRecording()
    # Rerun logs a warning that there is no footer; it would grow in memory.
    os.environ.setdefault("RUST_LOG", "warn,re_log_encoding=error")
    with _rerun_needed():
        from fgpose.viewer.rerun.session import Target
        from fgpose.viewer.rerun.system import RerunSystemRecording
    target = Target(
        None if path is None else Path(path), port if live else None, endless=True, made_by="live", server_mb=_SYSTEM_MB
    )
    # The oldest are dropped for viewers; a limit would end the pictures after some hours.
    pictures = PictureOptions(None, 80, None, None)
    return RerunSystemRecording(target, rig, skeleton, up, pictures)


def has_rerun() -> bool:
    """Whether Rerun is installed. It is looked for, not imported: that takes a second."""
    return importlib.util.find_spec("rerun") is not None


@contextmanager
def _rerun_needed() -> Iterator[None]:
    leave_out_analytics()
    try:
        yield
    except ModuleNotFoundError as error:
        if error.name != "rerun":
            raise
        raise ImportError("the viewer needs Rerun: pip install 'fgpose[viewer]'") from None
