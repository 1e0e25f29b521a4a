"""Cameras and networks in processes: what comes of them, whatever happens to a process."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import counting_network
import numpy as np
import pytest
from made_videos import SIZE_PX, pictures, write_video

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.io.live.recordings import RecordedImage
from fgpose.live.cameras.camera import CameraEvent
from fgpose.live.cameras.image import SourceImage
from fgpose.live.cameras.rig_file import LiveRig
from fgpose.live.clock import Clock
from fgpose.live.frame import CameraState
from fgpose.live.processes import camera_process
from fgpose.live.processes.camera_feed import CameraFeed
from fgpose.live.processes.parts import Parts
from fgpose.live.sources import CameraSource
from fgpose.people_observations import Detections

pytest.importorskip("av")
pytestmark = pytest.mark.slow
LONG_S = 120.0
N_IMAGES = 20


@pytest.fixture
def three(rig: CameraRig) -> CameraRig:
    """Whose images have the size of the made videos."""

    def small(camera: Camera) -> Camera:
        return replace(camera, size_px=SIZE_PX)

    return CameraRig(tuple(small(camera) for camera in rig.cameras[:3]))


@pytest.fixture(scope="module")
def videos(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("videos")
    return [write_video(folder / f"{k}.mp4", pictures(N_IMAGES), 30) for k in range(2)]


def live_rig(rig: CameraRig, *sources: CameraSource) -> LiveRig:
    return LiveRig(rig, dict(zip(rig.names, sources, strict=True)))


def looping(rig: CameraRig, videos: list[Path]) -> LiveRig:
    two = CameraRig(rig.cameras[:2])
    return live_rig(two, *(CameraSource(source=str(path), loop=True) for path in videos))


def number(image: RecordedImage) -> int:
    return round(float(image.detections.points2d_px[0, 0, 0]))


def state_of(feed: CameraFeed, camera: str) -> CameraState:
    return next(status.state for status in feed.statuses() if status.name == camera)


def taken_until(feed: CameraFeed, condition: Callable[[list[RecordedImage]], object]) -> list[RecordedImage]:
    """Images used as soon as they come, until something is so."""
    images: list[RecordedImage] = []
    end_s = time.monotonic() + LONG_S
    while not condition(images):
        assert time.monotonic() < end_s, feed.statuses()
        new = feed.take(0.05)
        feed.go_on([image.detections.camera for image in new])
        images += new
    return images


def test_nothing_is_left_out_of_recordings_as_fast_as_possible_and_keypoints_come_beside_them(
    three: CameraRig, videos: list[Path]
) -> None:
    files = [CameraSource(source=str(path), pace="fast") for path in videos]
    a, b, c = three.names
    with CameraFeed(
        live_rig(three, *files, CameraSource(source="zmq")), Clock(), counting_network.open_counting
    ) as feed:
        assert [*feed.received] == [c]
        received = feed.received[c].receive(
            SourceImage(detections=Detections(c, 0.0, np.ones((1, 1, 2)), np.ones((1, 1))))
        )
        assert received is not None
        assert received.detections is not None
        feed.deliver(received.recorded(received.detections))
        images = taken_until(feed, lambda images: len(images) == 2 * N_IMAGES + 1)
        taken_until(feed, lambda _: feed.statuses()[0].n_images == N_IMAGES)
    by_camera = {name: [image for image in images if image.detections.camera == name] for name in three.names}
    assert [number(image) for image in by_camera[a]] == list(range(N_IMAGES))
    assert [number(image) for image in by_camera[b]] == list(range(N_IMAGES))
    assert by_camera[c][0].detections.time_s == by_camera[c][0].arrived_s  # its source gave no stamp
    times_s = [[image.detections.time_s for image in by_camera[name]] for name in (a, b)]
    assert times_s[0] == pytest.approx(times_s[1], abs=1e-6)  # recordings begin together


def test_a_camera_goes_on_when_its_image_was_used(three: CameraRig, videos: list[Path]) -> None:
    with CameraFeed(looping(three, videos), Clock(), counting_network.open_counting) as feed:
        a, b = feed.rig.names
        taken_until(feed, lambda images: len(images) > 4)
        waiting: dict[str, RecordedImage] = {}
        end_s = time.monotonic() + LONG_S
        while waiting.keys() != {a, b}:
            assert time.monotonic() < end_s
            waiting |= {image.detections.camera: image for image in feed.take(0.05)}
        assert feed.take(0.5) == []  # the cameras wait
        feed.go_on([a])
        images: list[RecordedImage] = []
        end_s = time.monotonic() + LONG_S
        while not images:
            assert time.monotonic() < end_s
            images = feed.take(0.05)
        assert {image.detections.camera for image in images} == {a}
        # The newest image, not the one that came first while nobody looked: that is a 30th of a second later.
        assert images[0].detections.time_s > waiting[a].detections.time_s + 0.25
        assert state_of(feed, b) is CameraState.OK


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP])
def test_a_process_that_ends_or_hangs_is_started_again(
    three: CameraRig, videos: list[Path], how: signal.Signals, monkeypatch: pytest.MonkeyPatch
) -> None:
    # So long it hangs for; one that is stopped is found out at once.
    monkeypatch.setattr(camera_process, "_HANGS_S", LONG_S)
    parts, rig = Parts(), looping(three, videos)
    with CameraFeed(rig, Clock(), counting_network.open_counting, n_jobs=2, parts=parts) as feed:
        a, b = feed.rig.names
        taken_until(feed, lambda _: all(status.state is CameraState.OK for status in feed.statuses()))
        first, second = feed.process_ids
        os.kill(first, how)
        taken_until(feed, lambda _: state_of(feed, a) is not CameraState.OK)
        assert state_of(feed, b) is CameraState.OK
        began_s = feed.statuses()[0].image_s
        assert began_s is not None
        images = taken_until(
            feed,
            lambda images: (
                any(image.detections.camera == a and image.detections.time_s > began_s + 0.5 for image in images)
                and state_of(feed, a) is CameraState.OK
            ),
        )
        assert feed.process_ids[0] != first
        assert feed.process_ids[1] == second
        assert any(image.detections.camera == b for image in images)  # the other has gone on
    (restarts,) = parts.so_far()
    assert (restarts.part, restarts.n, restarts.reason) == (f"the process of {a}", 1, "status -9")


def test_a_network_that_hangs_is_begun_again_with_its_process(
    three: CameraRig, videos: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HANGS_ONCE", str(tmp_path / "has hung"))
    parts, rig = Parts(), looping(three, videos)
    with CameraFeed(rig, Clock(), counting_network.open_hanging, n_jobs=1, parts=parts) as feed:
        (first,) = feed.process_ids
        taken_until(feed, lambda images: images and feed.process_ids != (first,))
        names = ", ".join(feed.rig.names)
    (restarts,) = parts.so_far()
    assert (restarts.part, restarts.n) == (f"the process of {names}", 1)
    assert restarts.reason.startswith("the network does not answer for an image of ring_")


def test_states_and_pictures_are_told(three: CameraRig, videos: list[Path]) -> None:
    events: list[CameraEvent] = []
    shown: dict[str, tuple[np.ndarray, float]] = {}
    began_s = time.time()
    with CameraFeed(
        looping(three, videos),
        Clock(),
        counting_network.open_counting,
        on_event=events.append,
        show=lambda camera, picture, time_s: shown.update({camera: (picture, time_s)}),
    ) as feed:
        taken_until(feed, lambda _: len(shown) == 2 and len(events) >= 2)
        assert {(event.camera, event.state) for event in events[:2]} == {
            (name, CameraState.OK) for name in feed.rig.names
        }
    assert all(picture.shape == (SIZE_PX[1], SIZE_PX[0], 3) for picture, _ in shown.values())
    # By the clock of the images.
    assert all(began_s - 1 < time_s < time.time() + 1 for _, time_s in shown.values())


@pytest.mark.parametrize(
    ("open_network", "error", "message"),
    [
        (counting_network.open_nothing, ValueError, "these are no weights"),
        (counting_network.open_crashing, OSError, "the process of cameras ended with status -11"),
        (None, ValueError, "a network is needed for the images of"),
    ],
)
def test_a_network_that_cannot_be_opened(
    three: CameraRig, videos: list[Path], open_network: object, error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        CameraFeed(looping(three, videos), Clock(), open_network)  # pyrefly: ignore[bad-argument-type]


def test_all_recordings_that_cannot_be_opened_are_named(three: CameraRig, videos: list[Path]) -> None:
    sources = [CameraSource(source=source) for source in ("nothing.mp4", str(videos[0]), "neither.mp4")]
    a, _, c = three.names
    with pytest.raises(ValueError, match="there is no such thing") as error:
        CameraFeed(live_rig(three, *sources), Clock(), counting_network.open_counting, n_jobs=3)
    assert [line.split(":")[0] for line in str(error.value).splitlines()] == [f"camera {a}", f"camera {c}"]


def test_without_any_camera_it_waits_and_says_why(three: CameraRig, caplog: pytest.LogCaptureFixture) -> None:
    sources = [CameraSource(source=source) for source in ("rtsp://viewer:hunter2@127.0.0.1:1/a", "99")]
    two = CameraRig(three.cameras[:2])
    with CameraFeed(live_rig(two, *sources), Clock(), counting_network.open_counting, n_jobs=2) as feed:
        assert "no camera can be opened: waiting for them" in caplog.text
        taken_until(feed, lambda _: all(": " in status.reason for status in feed.statuses()))
        assert [(status.state, status.reason) for status in feed.statuses()] == [
            (CameraState.RECONNECTING, "rtsp://127.0.0.1:1/...: nothing answers there"),
            (CameraState.RECONNECTING, "/dev/video99: there is no such thing"),
        ]
