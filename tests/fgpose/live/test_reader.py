"""Readers of sources that fail in every way."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from itertools import chain, count
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from http_camera import http_camera
from made_videos import SIZE_PX, counted, pictures, room, write_video

from fgpose.live.cameras import reader as reader_module
from fgpose.live.cameras.camera import CameraEvent, LiveCamera
from fgpose.live.cameras.image import ArrayPicture, Image, SourceImage
from fgpose.live.cameras.mailbox import Mailbox
from fgpose.live.cameras.reader import CameraReader
from fgpose.live.clock import Clock
from fgpose.live.frame import CameraState
from fgpose.live.processes.parts import Parts
from fgpose.live.sources import CameraSource, ImageSource, SourceError, open_source
from fgpose.live.sources.playback import Playback

# Tests wait for what must happen, at most so long; nothing is timed.
LONG_S = 120.0


class Script:
    """A source that gives the images of a generator."""

    size_px = SIZE_PX
    is_recording = False

    def __init__(self, images: Iterator[SourceImage]) -> None:
        self._images = images
        self.is_closed = False

    def images(self) -> Iterator[SourceImage]:
        return self._images

    def hurry(self, late_s: float) -> None:
        self.late_s = late_s

    def close(self) -> None:
        self.is_closed = True


class Watched:
    """A camera with a reader that is looked at until something is so."""

    def __init__(self, open_source: Callable[[], ImageSource], settings: CameraSource) -> None:
        self.events: list[CameraEvent] = []
        self.camera = LiveCamera("cam01", settings, Clock(), 60.0, on_event=self.events.append)
        self.mailbox = Mailbox[Image]()
        self.reader = CameraReader(self.camera, self.mailbox, open_source, SIZE_PX)
        self.reader.start()

    def until(self, condition: Callable[[], object]) -> None:
        end_s = time.monotonic() + LONG_S
        while not condition():
            assert time.monotonic() < end_s, self.events
            self.reader.watch()
            time.sleep(0.02)

    def state(self) -> CameraState:
        return self.camera.status(self.camera.clock.now_s()).state

    def reason(self) -> str:
        return self.camera.status(self.camera.clock.now_s()).reason

    def has_said(self, state: CameraState, reason: str = "") -> bool:
        return any(event.state is state and reason in event.reason for event in self.events)


@pytest.fixture(autouse=True)
def _short_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reader_module, "_FIRST_WAIT_S", 0.02)


def image() -> SourceImage:
    return SourceImage(ArrayPicture(np.zeros((SIZE_PX[1], SIZE_PX[0], 3), np.uint8)))


def forever() -> Iterator[SourceImage]:
    while True:
        time.sleep(0.01)
        yield image()


def test_whatever_a_source_raises_it_is_opened_again() -> None:
    def fails(error: Exception) -> Iterator[SourceImage]:
        yield image()
        raise error

    scripts = [
        Script(fails(SourceError("cam01", "rtsp://a", "the stream has ended"))),
        Script(fails(RuntimeError("rtsp://viewer:hunter2@a"))),
        Script(fails(MemoryError())),
        Script(forever()),
    ]
    remaining = iter(scripts)
    watched = Watched(lambda: next(remaining), CameraSource(source="rtsp://a"))
    watched.until(lambda: watched.camera.status(0.0).n_images > 10)
    watched.reader.stop()
    reasons = [event.reason for event in watched.events if event.state is CameraState.RECONNECTING]
    assert reasons == [
        "rtsp://a: the stream has ended",
        "its source has failed with RuntimeError",
        "its source has failed with MemoryError",
    ]
    assert "hunter2" not in str(watched.events)
    assert all(script.is_closed for script in scripts)


def test_the_waits_between_attempts_grow(monkeypatch: pytest.MonkeyPatch) -> None:
    waits_s: list[float] = []

    def refuse() -> ImageSource:
        raise SourceError("cam01", "rtsp://a", "nothing answers there")

    camera = LiveCamera("cam01", CameraSource(source="rtsp://a"), Clock(), 60.0)
    monkeypatch.setattr(reader_module, "_FIRST_WAIT_S", 0.5)
    reader = CameraReader(camera, Mailbox[Image](), refuse, SIZE_PX)

    def wait(wait_s: float) -> None:
        waits_s.append(wait_s)
        if len(waits_s) == 7:
            reader._stopped.set()

    monkeypatch.setattr(reader._stopped, "wait", wait)
    reader.start()
    assert reader._thread is not None
    reader._thread.join(LONG_S)
    assert waits_s == [0.5, 1.0, 2.0, 4.0, 8.0, 10.0, 10.0]


def test_a_read_that_hangs_is_left_behind_and_replaced() -> None:
    released = threading.Event()

    def hangs() -> Iterator[SourceImage]:
        yield image()
        released.wait(LONG_S)
        yield image()

    stuck = Script(hangs())
    # On a busy computer a source that works may be taken to hang, too.
    scripts = chain([stuck], (Script(forever()) for _ in count()))
    watched = Watched(lambda: next(scripts), CameraSource(source="/dev/video0", timeout_s=0.5))
    watched.until(lambda: watched.camera.status(0.0).n_images > 10)
    assert watched.has_said(CameraState.RECONNECTING, "hangs")
    watched.reader.stop()
    n_images = watched.camera.status(0.0).n_images
    released.set()
    watched.until(lambda: stuck.is_closed)
    assert watched.camera.status(0.0).n_images == n_images  # what the old thread reads is not used


def test_stopping_does_not_wait_for_a_read_that_hangs() -> None:
    released = threading.Event()

    def hangs() -> Iterator[SourceImage]:
        yield image()
        released.wait(LONG_S)

    watched = Watched(lambda: Script(hangs()), CameraSource(source="rtsp://a"))
    watched.until(lambda: watched.camera.status(0.0).n_images == 1)
    watched.reader.stop(timeout_s=0.05)
    assert not released.is_set()
    released.set()


def test_everything_is_read_even_if_nobody_takes_it() -> None:
    given = []

    def many() -> Iterator[SourceImage]:
        for k in range(1000):
            given.append(k)
            yield image()
        yield from forever()

    watched = Watched(lambda: Script(many()), CameraSource(source="rtsp://a"))
    watched.until(lambda: len(given) == 1000)
    watched.reader.stop()
    newest = watched.mailbox.take()
    assert newest is not None
    assert newest.number >= 999


def test_a_recording_as_fast_as_possible_loses_nothing_and_its_end_is_said(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.mp4", pictures(20))
    settings = CameraSource(source=str(path), pace="fast")
    clock = Clock()
    watched = Watched(lambda: open_source("cam01", settings, clock, Playback(clock)), settings)
    taken = []

    def take() -> bool:
        newest = watched.mailbox.take()
        if newest is not None:
            taken.append(counted(newest.picture))
        return len(taken) == 20

    watched.until(take)
    assert taken == list(range(20))
    watched.until(lambda: watched.has_said(CameraState.LOST, "the recording has ended"))
    watched.reader.stop()


def test_a_network_camera_with_every_fault() -> None:
    frames = pictures(25)
    with http_camera(frames) as network:
        settings = CameraSource(source=network.url("viewer:hunter2@"), timeout_s=1.0)
        clock = Clock()
        watched = Watched(lambda: open_source("cam01", settings, clock, Playback(clock)), settings)
        watched.until(lambda: watched.has_said(CameraState.OK))

        network.mode = "hangs"
        # That it is lost until then is in test_health: here nobody may have looked meanwhile.
        watched.until(lambda: watched.has_said(CameraState.RECONNECTING, "nothing came for 1 s"))
        network.mode = "plays"
        watched.until(lambda: watched.state() is not CameraState.RECONNECTING)

        network.mode = "hangs up"
        watched.until(lambda: watched.has_said(CameraState.RECONNECTING, "broke off"))
        network.mode = "plays"
        watched.until(lambda: watched.state() is not CameraState.RECONNECTING)

        network.set_frames([frames[0]])
        watched.until(lambda: "the same picture" in watched.reason())
        network.set_frames(frames)
        watched.until(lambda: "the same picture" not in watched.reason())

        network.set_frames([np.zeros_like(frame) for frame in frames])
        watched.until(lambda: "black or covered" in watched.reason())
        network.set_frames(frames)
        watched.until(lambda: "black or covered" not in watched.reason())

        network.set_frames([room((320, 240))])
        watched.until(lambda: watched.has_said(CameraState.RECONNECTING, "320 x 240 px instead of 160 x 120 px"))
        watched.reader.stop()
    assert "hunter2" not in str(watched.events)


def test_a_thread_that_has_ended_is_begun_again(monkeypatch: pytest.MonkeyPatch) -> None:
    parts, begun = Parts(), []
    camera = LiveCamera("cam01", CameraSource(source="rtsp://a"), Clock(), 60.0)
    reader = CameraReader(camera, Mailbox[Image](), Mock(), SIZE_PX, parts=parts)
    monkeypatch.setattr(reader, "_run", lambda: begun.append(1))
    reader.start()
    assert reader._thread is not None
    reader._thread.join(LONG_S)
    reader.watch()
    reader.stop()
    assert len(begun) == 2
    assert [(each.part, each.n) for each in parts.so_far()] == [("reading cam01", 1)]
