"""All cameras of a rig, from its file to their newest images."""

from __future__ import annotations

import queue
import socket
import time
from pathlib import Path

import pytest
from http_camera import http_camera
from made_videos import SIZE_PX, counted, pictures, write_video

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.live.cameras.camera import CameraEvent
from fgpose.live.cameras.rig_file import LiveRig
from fgpose.live.cameras.running import LiveCameras
from fgpose.live.clock import Clock
from fgpose.live.frame import CameraState
from fgpose.live.sources import CameraSource

pytest.importorskip("av")
LONG_S = 120.0


@pytest.fixture
def small_rig(rig: CameraRig) -> CameraRig:
    """Whose images have the size of the made videos."""

    def small(camera: Camera) -> Camera:
        return Camera(
            name=camera.name,
            size_px=SIZE_PX,
            K=camera.K,
            world_T_camera=camera.world_T_camera,
            distortion=camera.distortion,
        )

    return CameraRig(tuple(small(camera) for camera in rig.cameras[:3]))


@pytest.fixture(scope="module")
def videos(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("videos")
    return [write_video(folder / f"{k}.mp4", pictures(20), 30) for k in range(2)]


def live_rig(rig: CameraRig, *sources: CameraSource) -> LiveRig:
    return LiveRig(rig, dict(zip(rig.names, sources, strict=True)))


def test_images_of_all_cameras_come_with_their_times(small_rig: CameraRig, videos: list[Path]) -> None:
    two = CameraRig(small_rig.cameras[:2])
    files = [CameraSource(source=str(path), pace="fast") for path in videos]
    taken: dict[str, list[int]] = {name: [] for name in two.names}
    times_s: dict[str, list[float]] = {name: [] for name in two.names}
    with LiveCameras(live_rig(two, *files), Clock()) as cameras:
        end_s = time.monotonic() + LONG_S
        while sum(map(len, taken.values())) < 40:
            assert time.monotonic() < end_s
            with cameras.changed:
                cameras.changed.wait(0.1)
            for name, mailbox in cameras.mailboxes.items():
                image = mailbox.take()
                if image is not None:
                    times_s[name].append(image.captured_s)
                    taken[name].append(counted(image.picture))
        assert [status.n_images for status in cameras.statuses()] == [20, 20]
    a, b = two.names
    assert taken == {a: list(range(20)), b: list(range(20))}
    assert times_s[a] == pytest.approx(times_s[b], abs=1e-6)  # recordings begin together


def test_recordings_that_cannot_be_opened_are_said_before_any_work(small_rig: CameraRig, videos: list[Path]) -> None:
    a, b, _ = small_rig.names
    bad = [CameraSource(source=source) for source in ("nothing.mp4", "neither.mp4")]
    with pytest.raises(ValueError, match="there is no such thing") as error:
        LiveCameras(live_rig(small_rig, *bad, CameraSource(source=str(videos[0]))), Clock())
    assert [line.split(":")[0] for line in str(error.value).splitlines()] == [f"camera {a}", f"camera {b}"]


def test_a_camera_that_is_switched_on_later_joins(small_rig: CameraRig) -> None:
    one, said = CameraRig(small_rig.cameras[:1]), queue.Queue[CameraEvent]()
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        port = found.getsockname()[1]
    source = CameraSource(source=f"http://viewer:hunter2@127.0.0.1:{port}/video.mjpg")
    with LiveCameras(live_rig(one, source), Clock(), on_event=said.put) as cameras:
        assert [*cameras.awaited] == [*one.names]
        event = said.get(timeout=LONG_S)
        assert event.state is CameraState.RECONNECTING
        assert event.reason == f"http://127.0.0.1:{port}/...: nothing answers there"
        with http_camera(pictures(20), port=port):
            while event.state is not CameraState.OK:
                event = said.get(timeout=LONG_S)


def test_images_of_another_size_than_the_calibration(rig: CameraRig, videos: list[Path]) -> None:
    one = CameraRig(rig.cameras[:1])
    with pytest.raises(ValueError, match=f"camera {rig.names[0]}: the images are 160 x 120, the calibration is for"):
        LiveCameras(live_rig(one, CameraSource(source=str(videos[0]))), Clock())


def test_states_are_said_without_anybody_asking(small_rig: CameraRig, videos: list[Path]) -> None:
    one = CameraRig(small_rig.cameras[:1])
    said: list[CameraState] = []
    source = CameraSource(source=str(videos[0]))
    with LiveCameras(live_rig(one, source), Clock(), on_event=lambda event: said.append(event.state)):
        end_s = time.monotonic() + LONG_S
        while CameraState.LOST not in said and time.monotonic() < end_s:
            time.sleep(0.02)
    assert said[-1] is CameraState.LOST  # the recording has ended
