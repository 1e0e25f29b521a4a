"""A real RTSP camera: GStreamer's server, where it is installed.

Debian: apt-get install gir1.2-gst-rtsp-server-1.0 gstreamer1.0-plugins-good gstreamer1.0-plugins-bad python3-gi
"""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from made_videos import SIZE_PX, pictures, write_video

from fgpose.live.cameras.clock_model import ClockModel
from fgpose.live.clock import Clock
from fgpose.live.sources import CameraSource, SourceError, open_source
from fgpose.live.sources.playback import Playback

pytest.importorskip("av")
SERVER = Path(__file__).with_name("rtsp_server.py")
PYTHON = shutil.which("python3", path="/usr/bin")


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Half a minute, longer than any test on a busy computer needs."""
    return write_video(tmp_path_factory.mktemp("rtsp") / "camera.mp4", pictures(25) * 36, 30)


@contextmanager
def rtsp_camera(video: Path, *login: str) -> Iterator[int]:
    """A server for a while; its port."""
    if PYTHON is None:
        pytest.skip("there is no Python of the system")
    with subprocess.Popen(
        [PYTHON, str(SERVER), str(video), *login], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as process:
        try:
            assert process.stdout is not None
            port = process.stdout.readline().strip()
            if not port:
                pytest.skip("GStreamer's RTSP server is not installed")
            yield int(port)
        finally:
            process.kill()


@pytest.mark.slow
def test_a_camera_that_sends_its_time(video: Path) -> None:
    clock = Clock()
    with rtsp_camera(video, "viewer:hunter2") as port:
        for login in ("", "viewer:swordfish@"):
            with pytest.raises(SourceError, match="the user name or the password is wrong") as error:
                open_source(
                    "cam01", CameraSource(source=f"rtsp://{login}127.0.0.1:{port}/camera"), clock, Playback(clock)
                )
            assert "swordfish" not in str(error.value)
        settings = CameraSource(source=f"rtsp://viewer:hunter2@127.0.0.1:{port}/camera")
        source = open_source("cam01", settings, clock, Playback(clock))
        assert (source.size_px, source.is_recording) == (SIZE_PX, False)
        model = ClockModel()
        n_with_time, captured_s, arrived_s = 0, np.nan, np.nan
        for image in source.images():
            assert image.stamp is not None
            arrived_s = clock.now_s()
            captured_s = model.captured_s(image.stamp, arrived_s)
            if image.stamp.wall_s is not None:
                n_with_time += 1
                assert image.stamp.wall_s < arrived_s  # sender and receiver have one clock
            if n_with_time == 30:
                break
        # Of a busy computer the time may not be believed; it is never worse than the arrival.
        assert captured_s <= arrived_s
        source.close()


@pytest.mark.slow
def test_a_camera_that_is_switched_off(video: Path) -> None:
    clock = Clock()
    with rtsp_camera(video) as port:
        source = f"rtsp://127.0.0.1:{port}/camera"
        with pytest.raises(SourceError, match="there is no such thing"):
            open_source("cam01", CameraSource(source=source + "2"), clock, Playback(clock))
        opened = open_source("cam01", CameraSource(source=source, timeout_s=2.0), clock, Playback(clock))
        images = opened.images()
        next(images)
    with pytest.raises(SourceError, match="camera cam01: rtsp://127"):
        list(images)
    opened.close()
    with pytest.raises(SourceError, match="nothing answers there"):
        open_source("cam01", CameraSource(source=source), clock, Playback(clock))
