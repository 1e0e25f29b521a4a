"""The live system on the videos of the demonstration."""

from __future__ import annotations

import tempfile
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fgpose.cli.options import new_console

if TYPE_CHECKING:
    from fgpose.monocular.downloads.demo_videos import DemoVideos

# 30 images a second of 540 x 960 pixels: two cores keep up.
_EVERY = _SHRINK = 2


@dataclass(frozen=True)
class LiveDemo:
    """What a demonstration of the live system leaves."""

    record: Path
    rrd: Path


def run_live_demo(recording: DemoVideos, what: str, output: Path, max_people: int, duration_s: float) -> LiveDemo:
    """Play videos as cameras, and estimate, show and record what they see, for so long or until Ctrl-C.

    Args:
        recording: the videos.
        what: is seen in them.
        output: the folder of the results.
        max_people: in an image.
        duration_s: how long.

    Raises:
        ValueError: what was fetched is damaged.
        OSError: the videos cannot be fetched, or the results cannot be written.
    """
    from fgpose.cli.live_command import Live
    from fgpose.io.atomic import check_writable
    from fgpose.live.recording.played_cameras import RTSP_PACKAGES, played_cameras
    from fgpose.monocular.downloads.demo_videos import fetch_demo_videos

    check_writable(output)
    results = LiveDemo(output / "demo_live.fgpose", output / "demo_live.rrd")
    # A recording is never written over; that of the last demonstration may go.
    results.record.unlink(missing_ok=True)
    console, status = new_console(), new_console(stderr=True).status("looking for the videos")
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="fgpose-")))
        with status:
            fetched = fetch_demo_videos(recording=recording, progress=status.update)
            videos = {path.stem: path for path in sorted((fetched / "videos").glob("*.mp4"))}
            calibration = fetched / "calibration" / "Calib.qca.txt"
            played = stack.enter_context(
                played_cameras(videos, calibration, folder, every=_EVERY, shrink=_SHRINK, progress=status.update)
            )
        how = "over RTSP" if played.is_rtsp else f"as files (over RTSP with: apt-get install {RTSP_PACKAGES})"
        console.print(f"videos of {what}, in real time {how}: {fetched}", soft_wrap=True)
        Live(
            rig=played.rig_file,
            max_people=max_people,
            page=0,
            record=results.record,
            rrd=results.rrd,
            duration_s=duration_s,
        ).run()
    return results
