"""Files, folders and network streams, with all that can be wrong with them."""

from __future__ import annotations

import os
import socket
import threading
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
import pytest
from http_camera import http_camera
from made_videos import SIZE_PX, counted, pictures, write_video

from fgpose.live.cameras.image import SourceImage
from fgpose.live.clock import Clock, SimulatedClock
from fgpose.live.sources import CameraSource, ImageSource, SourceError, open_source
from fgpose.live.sources.address import with_environment, without_password
from fgpose.live.sources.playback import Playback

pytest.importorskip("av")
FPS = 30
# Nothing waits for so long but a test that fails, or one of what hangs.
LONG_S = 60.0


def opened(settings: CameraSource, clock: Clock | None = None) -> ImageSource:
    clock = clock or SimulatedClock(1e9)
    return open_source("cam01", settings, clock, Playback(clock))


def rgb(image: SourceImage) -> np.ndarray:
    assert image.picture is not None
    return image.picture.rgb()


def since_first_s(images: list[SourceImage]) -> np.ndarray:
    stamps_s = np.array([image.stamp.stamp_s for image in images if image.stamp is not None])
    assert len(stamps_s) == len(images)
    return stamps_s - stamps_s[0]


@pytest.fixture(scope="module")
def frames() -> list[np.ndarray]:
    return pictures(20)


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory, frames: list[np.ndarray]) -> Path:
    return write_video(tmp_path_factory.mktemp("videos") / "cam01.mp4", frames, FPS)


def test_a_video_in_real_time(video: Path, frames: list[np.ndarray]) -> None:
    clock = SimulatedClock(1e9)
    source = opened(CameraSource(source=str(video)), clock)
    assert (source.size_px, source.is_recording) == (SIZE_PX, True)
    n_images = 0
    for k, image in enumerate(source.images()):
        n_images += 1
        assert clock.now_s() - 1e9 == pytest.approx(k / FPS, abs=1e-4)  # stamps of MP4 are rounded
        assert image.stamp is not None
        assert image.stamp.is_host_time
        assert image.stamp.stamp_s == pytest.approx(clock.now_s(), abs=1e-6)
        assert counted(rgb(image)) == k
        # H.264 at ultrafast keeps noisy pictures to some levels.
        assert np.abs(rgb(image).astype(float) - frames[k]).mean() < 8
    assert n_images == 20
    source.close()


def test_the_brightness_needs_no_conversion(video: Path) -> None:
    source = opened(CameraSource(source=str(video), pace="fast"))
    image = next(source.images())
    assert image.picture is not None
    luma = image.picture.luma().astype(float)
    grey = cv2.cvtColor(image.picture.rgb(), cv2.COLOR_RGB2GRAY)
    assert luma.shape == (SIZE_PX[1], SIZE_PX[0])
    assert np.corrcoef(luma.ravel(), grey.ravel())[0, 1] > 0.99  # video range instead of full range
    source.close()


def test_a_video_as_fast_as_possible_again_and_again(video: Path) -> None:
    clock = SimulatedClock(1e9)
    source = opened(CameraSource(source=str(video), pace="fast", loop=True), clock)
    images = list(islice(source.images(), 50))
    assert clock.now_s() == 1e9
    assert [counted(rgb(image)) for image in images] == [k % 20 for k in range(50)]
    np.testing.assert_allclose(since_first_s(images), np.arange(50) / FPS, atol=1e-4)
    source.close()


def test_another_rate_than_the_file_says(video: Path) -> None:
    source = opened(CameraSource(source=str(video), fps=10.0, loop=True))
    np.testing.assert_allclose(since_first_s(list(islice(source.images(), 30))), np.arange(30) / 10, atol=1e-6)
    source.close()


def test_recordings_that_loop_stay_in_step(tmp_path: Path, frames: list[np.ndarray]) -> None:
    clock = SimulatedClock(1e9)
    playback = Playback(clock)
    lengths = {"a": 20, "b": 17}  # one camera was stopped earlier
    sources = {}
    for name, n in lengths.items():
        path = write_video(tmp_path / f"{name}.mp4", frames[:n], FPS)
        sources[name] = open_source(name, CameraSource(source=str(path), pace="fast", loop=True), clock, playback)
    for name, source in sources.items():
        images = list(islice(source.images(), 3 * lengths[name]))
        since_s = np.array([image.stamp.stamp_s - 1e9 for image in images if image.stamp is not None])
        numbers = np.array([counted(rgb(image)) for image in images])
        np.testing.assert_allclose(since_s * FPS, np.round(since_s * FPS), atol=5e-3)
        np.testing.assert_array_equal(np.round(since_s * FPS) % 20, numbers)
        source.close()


def test_a_recording_that_is_opened_again_joins_the_others(video: Path) -> None:
    clock = SimulatedClock(1e9)
    playback = Playback(clock)
    assert playback.start_s == 1e9
    clock.advance(100 * 20 / FPS + 10.2 / FPS)  # in the eleventh image of round 100
    source = open_source("cam01", CameraSource(source=str(video), loop=True), clock, playback)
    image = next(source.images())
    assert counted(rgb(image)) == 11
    assert image.stamp is not None
    assert image.stamp.stamp_s - 1e9 == pytest.approx((100 * 20 + 11) / FPS, abs=1e-3)
    source.close()


def test_a_looping_recording_of_a_computer_that_cannot_keep_up_stays_in_step(video: Path) -> None:
    clock = SimulatedClock(1e9)
    source = opened(CameraSource(source=str(video), loop=True), clock)
    since_s = []
    for image in islice(source.images(), 100):
        assert image.stamp is not None
        since_s.append(image.stamp.stamp_s - 1e9)
        clock.advance(2.5 / FPS)  # the work on each image
    # It falls behind by 1.5 images with each; a round has 20. When the next begins it is where it should be, but for
    # what may be overdue.
    assert clock.now_s() - 1e9 - since_s[-1] < 1.5 * 20 / FPS + 1.0 + 1e-6
    assert np.ptp(np.diff(since_s)) > 10 / FPS
    source.close()


def test_a_folder_of_images(tmp_path: Path, frames: list[np.ndarray]) -> None:
    for k, frame in enumerate(frames[:3]):
        cv2.imwrite(str(tmp_path / f"image_{k + 9}.png"), cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))
    clock = SimulatedClock(1e9)
    source = opened(CameraSource(source=str(tmp_path), fps=5.0, loop=True), clock)
    images = list(islice(source.images(), 7))
    assert clock.now_s() == pytest.approx(1e9 + 6 / 5)
    for k, image in enumerate(images):
        np.testing.assert_array_equal(rgb(image), frames[k % 3])
    np.testing.assert_allclose(since_first_s(images), np.arange(7) / 5, atol=1e-6)


def test_an_image_that_cannot_be_read_is_damaged(tmp_path: Path, frames: list[np.ndarray]) -> None:
    for k, frame in enumerate(frames[:3]):
        cv2.imwrite(str(tmp_path / f"{k}.png"), frame)
    (tmp_path / "1.png").write_bytes(b"not an image")
    images = list(opened(CameraSource(source=str(tmp_path), fps=5.0)).images())
    assert [image.is_damaged for image in images] == [False, True, False]


def test_damaged_packets_are_no_pictures(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.avi", pictures(30), FPS, codec="mjpeg")
    content = bytearray(path.read_bytes())
    rng = np.random.default_rng(0)
    middle = slice(len(content) // 2, len(content) // 2 + len(content) // 4)
    content[middle] = rng.bytes(middle.stop - middle.start)
    path.write_bytes(content)
    images = list(opened(CameraSource(source=str(path), pace="fast")).images())
    n_good = sum(not image.is_damaged for image in images)
    assert 10 <= n_good < 30
    assert all(image.picture is None or image.picture.size_px == SIZE_PX for image in images)


SECRET = "hunter2"
BAD = {
    "no file": ("nothing.mp4", "there is no such thing"),
    "no device": ("/dev/video99", "there is no such thing"),
    "no protocol": ("gopher2://camera", "Protocol not found"),
    "nobody there": (f"rtsp://viewer:{SECRET}@127.0.0.1:1/{SECRET}", "rtsp://127.0.0.1:1/...: nothing answers there"),
    "password in the query": (f"http://127.0.0.1:1/a?pwd={SECRET}", "http://127.0.0.1:1/...: nothing answers"),
    "unknown host": (f"rtsp://viewer:{SECRET}@nowhere.invalid/stream", "rtsp://nowhere.invalid/...: "),
}


@pytest.mark.parametrize("name", BAD)
def test_what_cannot_be_opened_is_one_clear_error_without_password(name: str) -> None:
    source, message = BAD[name]
    with pytest.raises(SourceError, match="camera cam01: ") as error:
        opened(CameraSource(source=source))
    assert message in str(error.value)
    assert SECRET not in repr(error.getrepr(chain=True, showlocals=False))
    assert error.value.__cause__ is None
    assert error.value.__suppress_context__


def test_what_is_no_video(tmp_path: Path, frames: list[np.ndarray]) -> None:
    text = tmp_path / "a.mp4"
    text.write_text("[video]\n" * 1000)
    with pytest.raises(SourceError, match=r"not a video|no video in it"):  # FFmpeg may take it for subtitles
        opened(CameraSource(source=str(text)))
    truncated = tmp_path / "b.mp4"
    truncated.write_bytes(write_video(tmp_path / "c.mp4", frames, FPS).read_bytes()[:3000])
    with pytest.raises(SourceError, match="not a video, or a damaged or truncated one"):
        opened(CameraSource(source=str(truncated)))
    folder = tmp_path / "folder"
    folder.mkdir()
    with pytest.raises(SourceError, match="fps is missing"):
        opened(CameraSource(source=str(folder)))
    with pytest.raises(SourceError, match="there are no images in it"):
        opened(CameraSource(source=str(folder), fps=5.0))


def test_http_pictures_have_no_stamps(frames: list[np.ndarray]) -> None:
    with http_camera(frames) as camera:
        source = opened(CameraSource(source=camera.url()), Clock())
        assert (source.size_px, source.is_recording) == (SIZE_PX, False)
        images = list(islice(source.images(), 5))
        source.close()
    assert all(image.stamp is None for image in images)  # FFmpeg would make up 25 a second
    numbers = np.array([counted(rgb(image)) for image in images])
    np.testing.assert_array_equal(np.diff(numbers) % 20, 1)  # none is left out


def test_http_password(frames: list[np.ndarray]) -> None:
    with http_camera(frames) as camera:
        camera.password = SECRET
        opened(CameraSource(source=camera.url(f"viewer:{SECRET}@")), Clock()).close()
        with pytest.raises(SourceError, match="the user name or the password is wrong") as error:
            opened(CameraSource(source=camera.url("viewer:swordfish@")), Clock())
    assert "swordfish" not in str(error.value)


def test_a_stream_that_ends_or_hangs(frames: list[np.ndarray]) -> None:
    for mode, message in (
        ("hangs up", "the stream has ended|the connection broke off"),
        ("hangs", "nothing came for 1 s"),
    ):
        with http_camera(frames) as camera:
            source = opened(CameraSource(source=camera.url(), timeout_s=1.0), Clock())
            images = source.images()
            next(images)
            camera.mode = mode
            with pytest.raises(SourceError, match=message):
                list(images)
            source.close()


def test_a_server_that_never_answers() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        for scheme in ("http", "rtsp"):
            with pytest.raises(SourceError, match=r"nothing came for 0\.5 s"):
                opened(CameraSource(source=f"{scheme}://127.0.0.1:{port}/a", timeout_s=0.5))


def test_a_server_that_sends_noise() -> None:
    def serve(server: socket.socket) -> None:
        connection, _ = server.accept()
        with connection:
            connection.recv(1000)
            connection.sendall(b"HTTP/1.0 200 OK\r\n\r\n" + np.random.default_rng(0).bytes(100_000))

    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=serve, args=(server,))
        thread.start()
        with pytest.raises(SourceError, match="camera cam01: http://127"):
            opened(CameraSource(source=f"http://127.0.0.1:{server.getsockname()[1]}/a", timeout_s=LONG_S))
        thread.join()


@pytest.mark.parametrize(
    ("source", "text"),
    [
        ("rtsp://viewer:pass@10.0.0.2:554/stream1", "rtsp://10.0.0.2:554/..."),
        ("rtsp://viewer@10.0.0.2/stream1", "rtsp://10.0.0.2/..."),
        ("rtsp://10.0.0.2/user=admin_password=pass_channel=1.sdp", "rtsp://10.0.0.2/..."),
        ("rtsp://10.0.0.2/", "rtsp://10.0.0.2"),
        ("rtsp://10.0.0.2#pass", "rtsp://10.0.0.2/..."),
        ("http://10.0.0.2/video.cgi?user=a&pwd=pass", "http://10.0.0.2/..."),
        ("rtsp://viewer:p@ss@10.0.0.2/a", "rtsp://10.0.0.2/..."),
        ("rtsp://viewer:p/ss@10.0.0.2/a", "rtsp://..."),
        ("rtsp://viewer:1/ss@10.0.0.2/a", "rtsp://..."),
        ("rtsp://viewer:1#ss@10.0.0.2/a", "rtsp://..."),
        ("rtsp:/viewer:pass@10.0.0.2/a", "rtsp:/..."),
        ("rtsp//viewer:pass@10.0.0.2/a", "rtsp//..."),
        ("RTSP:viewer:pass@10.0.0.2/a", "RTSP:..."),
        ("viewer:pass@10.0.0.2/a", "..."),
        ("/dev/video0", "/dev/video0"),
        ("videos/a@b.mp4", "videos/a@b.mp4"),
        ("https.mp4", "https.mp4"),
    ],
)
def test_sources_are_shown_without_password(source: str, text: str) -> None:
    assert without_password(source) == text
    assert "pass" not in repr(CameraSource(source=source))


def test_passwords_from_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FGPOSE_CAM01_PASSWORD", SECRET)
    assert with_environment("rtsp://viewer:${FGPOSE_CAM01_PASSWORD}@a/b") == f"rtsp://viewer:{SECRET}@a/b"
    with pytest.raises(ValueError, match="environment variable FGPOSE_CAM02_PASSWORD is not set"):
        with_environment("rtsp://viewer:${FGPOSE_CAM02_PASSWORD}@a/b")


def test_a_pipe_is_no_video(tmp_path: Path) -> None:
    """Nobody writes into it: opening it would take for ever."""
    os.mkfifo(tmp_path / "cam01.mp4")
    with pytest.raises(SourceError, match=r"camera cam01: .*cam01\.mp4: "):
        opened(CameraSource(source=str(tmp_path / "cam01.mp4")))


@pytest.mark.parametrize("name", ["CAM01_PASSWORD", "AWS_SECRET_ACCESS_KEY", "fgpose_x", "HOME"])
def test_other_secrets_are_not_sent_to_cameras(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(name, SECRET)
    with pytest.raises(
        ValueError, match=rf"^\$\{{{name}\}}: only environment variables .* begin with FGPOSE_"
    ) as error:
        with_environment(f"http://host/${{{name}}}")
    assert SECRET not in str(error.value)
