"""Videos in place of cameras, and the demonstration that plays them to the live system."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_videos import SIZE_PX, counted, pictures, write_video
from stopped import stop_when

from fgpose.cli import main
from fgpose.geometry.camera import CameraRig
from fgpose.io.calibration import save_rig
from fgpose.live.cameras.rig_file import load_live_rig
from fgpose.live.cameras.running import LiveCameras
from fgpose.live.clock import Clock
from fgpose.live.frame import LiveFrame
from fgpose.live.recording import played_cameras as module
from fgpose.live.recording.live_recording import load_live_recording
from fgpose.live.recording.played_cameras import played_cameras
from fgpose.live.sources import open_source
from fgpose.live.sources.playback import Playback
from fgpose_benchmarks.synthetic import ring_rig

pytest.importorskip("av")
N_IMAGES = 24


@pytest.fixture(scope="module")
def rig() -> CameraRig:
    return CameraRig(
        tuple(
            replace(camera, name=f"cam_{n}", size_px=SIZE_PX, K=np.array([[150.0, 0, 80], [0, 150, 60], [0, 0, 1]]))
            for n, camera in enumerate(ring_rig(2).cameras)
        )
    )


@pytest.fixture(scope="module")
def calibration(tmp_path_factory: pytest.TempPathFactory, rig: CameraRig) -> Path:
    path = tmp_path_factory.mktemp("rig") / "Calib.toml"
    save_rig(rig, path)
    return path


@pytest.fixture(scope="module")
def videos(tmp_path_factory: pytest.TempPathFactory, rig: CameraRig) -> dict[str, Path]:
    """Of 0.8 s, with frames that refer to later ones."""
    folder = tmp_path_factory.mktemp("videos")
    options = {"tune": "film", "preset": "fast", "bf": "2"}
    return {
        name: write_video(folder / f"{name}.mp4", pictures(N_IMAGES, seed=n), 30, options=options)
        for n, name in enumerate(rig.names)
    }


def test_without_a_server_files_are_played_there_and_back(
    tmp_path: Path, rig: CameraRig, calibration: Path, videos: dict[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_SYSTEM_PYTHON", None)
    with played_cameras(videos, calibration, tmp_path, every=2) as played:
        assert not played.is_rtsp
        live_rig = load_live_rig(played.rig_file)
        clock = Clock()
        settings = replace(live_rig.sources["cam_1"], loop=False, pace="fast")
        source = open_source("cam_1", settings, clock, Playback(clock))
        numbers = [counted(image.picture.rgb()) for image in source.images() if image.picture is not None]
        source.close()
    there = list(range(0, N_IMAGES, 2))
    assert numbers == there + there[-2:0:-1]
    assert all(settings.loop for settings in live_rig.sources.values())


def test_the_calibration_is_that_of_smaller_images(
    tmp_path: Path, rig: CameraRig, calibration: Path, videos: dict[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_SYSTEM_PYTHON", None)
    with played_cameras(videos, calibration, tmp_path, shrink=2) as played:
        small = load_live_rig(played.rig_file).rig
    assert [camera.size_px for camera in small.cameras] == [(80, 60)] * 2
    point_m = np.array([0.1, 0.2, 1.0])
    # Corners of pixels are scaled, and the middle of the first is at 0.
    expected_px = (np.stack([camera.project(point_m) for camera in rig.cameras]) + 0.5) / 2 - 0.5
    np.testing.assert_allclose([camera.project(point_m) for camera in small.cameras], expected_px, atol=1e-6)


@pytest.mark.slow
def test_cameras_over_rtsp_are_in_step(tmp_path: Path, calibration: Path, videos: dict[str, Path]) -> None:
    with played_cameras(videos, calibration, tmp_path) as played:
        if not played.is_rtsp:
            pytest.skip("GStreamer's RTSP server is not installed")
        clock, seen = Clock(), dict[str, list[tuple[float, int]]]()
        with LiveCameras(load_live_rig(played.rig_file), clock) as cameras:
            end_s = time.monotonic() + 60
            # Until the cameras' own times are known, which come after some seconds.
            while not (len(seen) == 2 and min(map(len, seen.values())) >= 40) and time.monotonic() < end_s:
                with cameras.changed:
                    cameras.changed.wait(1.0)
                for image in filter(None, (mailbox.take() for mailbox in cameras.mailboxes.values())):
                    stamp = image.source.stamp
                    if stamp is not None and stamp.wall_s is not None:
                        seen.setdefault(image.camera, []).append((stamp.wall_s, counted(image.picture)))
            assert all(camera.n_images > 40 for camera in cameras.statuses())
    first, second = (np.array(seen[name]) for name in videos)
    nearest = np.abs(first[:, None, 0] - second[:, 0]).argmin(axis=1)
    together = np.abs(first[:, 0] - second[nearest, 0]) < 0.01
    assert together.any()
    # Numbers go up and down; at the turns, and where images were taken a moment apart, they differ by one.
    assert np.abs(first[together, 1] - second[nearest[together], 1]).max() <= 1


@pytest.mark.slow
@pytest.mark.network
@pytest.mark.filterwarnings("default")
@pytest.mark.usefixtures("demo_videos")
def test_the_demonstration(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    from rrd_contents import entities

    with_people = list[LiveFrame]()

    def is_enough(frame: LiveFrame) -> bool:
        with_people.extend([frame] if frame.people else [])
        return len(with_people) > 50

    stop_when(monkeypatch, is_enough)
    (tmp_path / "demo_live.fgpose").write_text("of the last time")
    assert main(["demo", "--live", "--output", str(tmp_path), "--duration-s", "600"]) == 0
    printed = capsys.readouterr()
    assert "status page: http://127.0.0.1:" in printed.err
    assert {path.name for path in tmp_path.iterdir()} == {"demo_live.fgpose", "demo_live.rrd"}
    for what in ("from image to frame: median", "rerun", "--replay", "fgpose smooth"):
        assert what in printed.out
    recording = load_live_recording(tmp_path / "demo_live.fgpose")
    seen = [frame for frame in recording.frames() if frame.people]
    assert seen
    # On a computer so busy that no image is looked at for a second, the man is lost and gets a new number.
    assert np.mean([len(frame.people) == 1 for frame in seen]) > 0.9
    shown = entities(tmp_path / "demo_live.rrd")
    assert "/world/person_0/joints" in shown
    assert all(f"/world/camera/{name}/image/picture" in shown for name in recording.rig.names)
