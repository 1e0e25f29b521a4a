"""Which images the networks look at."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest
from counting_network import SKELETON, CountingTracker

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.io.live.recordings import RecordedImage
from fgpose.live.cameras.image import ArrayPicture, Image, SourceImage
from fgpose.live.cameras.mailbox import Mailbox
from fgpose.live.cameras.running import LiveCameras
from fgpose.live.processes.detectors import Detectors
from fgpose.live.processes.parts import Parts
from fgpose.monocular.network import People, Tracker
from fgpose_benchmarks.synthetic import ring_rig

LONG_S = 120.0


class Slow:
    """Looks at an image only when it is let."""

    name, skeleton = "slow", SKELETON

    def __init__(self) -> None:
        self.may_look = threading.Semaphore(0)

    def tracker(self, camera: Camera) -> Tracker:
        def detect(picture: np.ndarray) -> People:
            assert self.may_look.acquire(timeout=LONG_S)
            return CountingTracker().detect(picture)

        tracker = CountingTracker()
        vars(tracker)["detect"] = detect
        return tracker


class Cameras(LiveCameras):
    """Three cameras whose images are put in by hand, without sources."""

    def __init__(self) -> None:
        self.rig: CameraRig = ring_rig(3)
        self.changed = threading.Condition()
        self.mailboxes = {name: Mailbox[Image](self.changed) for name in self.rig.names}

    def take_images(self, number: int) -> None:
        """All at the same time."""
        with self.changed:
            for name, mailbox in self.mailboxes.items():
                source = SourceImage(ArrayPicture(np.zeros((8, 8, 3), np.uint8)))
                mailbox.put(Image(name, number, float(number), float(number), source))


class Looking:
    """Detectors at work, and what they have delivered."""

    def __init__(self, cameras: Cameras) -> None:
        self.network, self._delivered = Slow(), list[RecordedImage]()
        self._came = threading.Condition()
        self.parts, self.fails = Parts(), False
        self.detectors = Detectors(cameras, self.network, self._deliver, n_threads=1, parts=self.parts)

    def times_s(self, n: int) -> list[float]:
        """When the next n images were taken at which the network is let look."""
        for _ in range(n):
            self.network.may_look.release()
        with self._came:
            assert self._came.wait_for(lambda: len(self._delivered) >= n, LONG_S)
            taken, self._delivered = self._delivered[:n], self._delivered[n:]
        return [image.detections.time_s for image in taken]

    def _deliver(self, image: RecordedImage) -> None:
        if self.fails:
            self.fails = False
            raise KeyError("delivered nowhere")
        with self._came:
            self._delivered.append(image)
            self._came.notify_all()


@pytest.fixture
def cameras() -> Cameras:
    return Cameras()


@pytest.fixture
def looking(cameras: Cameras, monkeypatch: pytest.MonkeyPatch) -> Iterator[Looking]:
    monkeypatch.setattr("counting_network.counted", lambda image: 0)
    looking = Looking(cameras)
    yield looking
    for _ in range(10):
        looking.network.may_look.release()
    looking.detectors.close()


def test_cameras_that_go_on_together_are_looked_at_as_they_were_then(cameras: Cameras, looking: Looking) -> None:
    """Although one thread looks at one after the other, while new images come."""
    cameras.take_images(1)
    looking.times_s(3)
    for number in (2, 3, 4):
        cameras.take_images(number)
    looking.detectors.go_on(cameras.rig.names)
    cameras.take_images(5)
    assert looking.times_s(3) == [4, 4, 4]


def test_a_camera_without_a_new_image_is_looked_at_when_it_has_one(cameras: Cameras, looking: Looking) -> None:
    cameras.take_images(1)
    looking.times_s(3)
    looking.detectors.go_on(cameras.rig.names)
    cameras.take_images(2)
    assert looking.times_s(3) == [2, 2, 2]


def test_a_thread_that_ends_is_begun_again_and_its_camera_goes_on(cameras: Cameras, looking: Looking) -> None:
    looking.fails = True
    cameras.take_images(1)
    looking.network.may_look.release()
    assert looking.times_s(2) == [1, 1]
    cameras.take_images(2)
    assert looking.times_s(1) == [2]
    assert [(each.part, each.n) for each in looking.parts.so_far()] == [("detector 0", 1)]


def test_a_network_that_does_not_answer_is_told(
    cameras: Cameras, looking: Looking, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fgpose.live.processes.detectors._HANGS_S", 0.0)
    assert looking.detectors.hung() == []
    cameras.take_images(1)
    end_s = time.monotonic() + LONG_S
    while not (hung := looking.detectors.hung()):
        assert time.monotonic() < end_s
    assert len(hung) == 1  # there is one thread
    monkeypatch.setattr("fgpose.live.processes.detectors._HANGS_S", LONG_S)
    assert looking.detectors.hung() == []


def test_an_answer_whose_arrays_do_not_fit_together_goes_nowhere(
    cameras: Cameras, looking: Looking, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    right = CountingTracker.detect

    def two_boxes(self: CountingTracker, image: np.ndarray) -> People:
        monkeypatch.setattr(CountingTracker, "detect", right)
        found = right(self, image)
        object.__setattr__(found, "boxes", np.repeat(found.boxes, 2, axis=0))
        return found

    monkeypatch.setattr(CountingTracker, "detect", two_boxes)
    cameras.take_images(1)
    looking.network.may_look.release()
    assert looking.times_s(2) == [1, 1]
    assert "the network failed on an image" in caplog.text
    assert "network slow gave points2d_px (1, 1, 2) for 2 boxes" in caplog.text
