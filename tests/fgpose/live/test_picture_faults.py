"""Faults in pictures of a noisy room through which somebody walks."""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np
import pytest
from made_videos import noisy, room

from fgpose.live.cameras.camera import LiveCamera
from fgpose.live.cameras.image import ArrayPicture, SourceImage
from fgpose.live.cameras.picture_faults import PictureFaults
from fgpose.live.clock import SimulatedClock
from fgpose.live.sources import CameraSource
from fgpose.people_observations import Detections

FPS = 20.0
SIZE_PX = (480, 270)


def walker(n: int, first: int = 0, sigma: float = 3.0) -> list[np.ndarray]:
    """Images with different noise, of a room with somebody who covers a fifth of it."""
    rng = np.random.default_rng(first)
    scene = room(SIZE_PX, seed=1)
    frames = []
    for k in range(first, first + n):
        frame = noisy(scene, rng, sigma)
        x = 4 * k % (SIZE_PX[0] - 96)
        frame[:, x : x + 96] = noisy(frame[:, x : x + 96] // 2 + 60, rng, sigma)
        frames.append(frame)
    return frames


class Watch:
    """Feeds pictures; remembers after how long a fault was found first."""

    def __init__(self, fps: float = FPS) -> None:
        self.faults, self.now_s, self._fps = PictureFaults(), 1000.0, fps
        self.found: dict[str, float] = {}

    def see(self, frames: Iterable[np.ndarray]) -> dict[str, str]:
        """The faults after the last of them."""
        began_s, self.found, last = self.now_s, {}, {}
        for frame in frames:
            last = self.faults.add(ArrayPicture(frame), self.now_s)
            for name in last:
                self.found.setdefault(name, self.now_s - began_s)
            self.now_s += 1 / self._fps
        return last


@pytest.fixture
def watch() -> Watch:
    """Which has seen a room without fault."""
    watch = Watch()
    watch.see(walker(80))
    assert not watch.found
    return watch


def check(watch: Watch, fault: str, frames: list[np.ndarray]) -> None:
    """The only fault, found within a second, and gone with it."""
    watch.see(frames)
    assert set(watch.found) == {fault}
    assert watch.found[fault] <= 1.0
    assert watch.see(walker(40, first=300)) == {}


def test_the_same_picture_again(watch: Watch) -> None:
    check(watch, "frozen", walker(1, first=80) * 30)


def test_a_black_picture(watch: Watch) -> None:
    rng = np.random.default_rng(5)
    check(watch, "black", [noisy(np.full((270, 480, 3), 16, np.uint8), rng, 1.0) for _ in range(30)])


def test_a_hand_before_the_lens(watch: Watch) -> None:
    rng = np.random.default_rng(6)
    hand = np.repeat(np.linspace(35, 60, 480)[None, :, None], 270, axis=0).repeat(3, axis=2)
    check(watch, "black", [noisy(hand, rng, 1.0) for _ in range(30)])


def test_lost_parts_that_are_grey(watch: Watch) -> None:
    frames = walker(30, first=80)
    for frame in frames:
        frame[108:] = 128  # three of five
    check(watch, "garbled", frames)


@pytest.mark.parametrize("shift_px", [(4, 2), pytest.param((45, -15), marks=pytest.mark.slow), (300, 150)])
def test_a_camera_that_was_moved(watch: Watch, shift_px: tuple[int, int]) -> None:
    matrix = np.array([[1.0, 0, shift_px[0]], [0, 1.0, shift_px[1]]])
    moved = [cv2.warpAffine(frame, matrix, SIZE_PX, borderMode=cv2.BORDER_WRAP) for frame in walker(30, first=80)]
    check(watch, "moved", moved)


def test_a_camera_that_was_turned(watch: Watch) -> None:
    matrix = cv2.getRotationMatrix2D((240, 135), 3.0, 1.0)
    turned = [cv2.warpAffine(frame, matrix, SIZE_PX, borderMode=cv2.BORDER_WRAP) for frame in walker(30, first=80)]
    check(watch, "moved", turned)


def test_a_knock_is_over_soon(watch: Watch) -> None:
    matrix = np.array([[1.0, 0, 20], [0, 1.0, 0]])
    knocked = [cv2.warpAffine(frame, matrix, SIZE_PX, borderMode=cv2.BORDER_WRAP) for frame in walker(6, first=80)]
    watch.see(knocked + walker(30, first=86))
    assert not watch.found


def test_somebody_who_hides_half_of_the_picture(watch: Watch) -> None:
    rng = np.random.default_rng(8)
    somebody = room((240, 270), seed=9)
    frames = walker(60, first=80)
    for k, frame in enumerate(frames):
        frame[:, 2 * k : 2 * k + 240] = noisy(somebody, rng)
    watch.see(frames)
    assert not watch.found


def test_a_lamp_that_is_switched_on(watch: Watch) -> None:
    watch.see(np.clip(frame * 1.4 + 10.0, 0, 255).astype(np.uint8) for frame in walker(60, first=80))
    assert not watch.found


def test_a_still_scene_without_noise_between_key_frames() -> None:
    # A codec that leaves the noise out repeats the picture until the next key frame, here every 2 s.
    watch = Watch()
    key_frames = [frame for frame in walker(12, sigma=1.0) for _ in range(40)]
    watch.see(key_frames[:200])
    watch.see(key_frames[200:])
    assert not watch.found
    # But a minute of one picture is frozen.
    assert "frozen" in watch.see(key_frames[-1:] * 200)


def test_a_frozen_picture_that_is_encoded_again() -> None:
    watch = Watch(fps=10.0)
    usual = [frame[::4, ::4] for frame in walker(8)]
    watch.see(usual[k % 8] for k in range(2000))  # 200 s
    frozen = usual[3]
    frames = []
    for k in range(20):
        frame = frozen.copy()
        frame[2 * k, :60] += 1  # what the quantisation changes
        frames.append(frame)
    assert "frozen" in watch.see(frames)
    assert watch.found["frozen"] <= 1.0


def test_a_slow_camera_may_repeat_a_picture() -> None:
    faults = PictureFaults()
    frames = walker(4)
    found = [faults.add(ArrayPicture(frames[k // 2]), float(k)) for k in range(8)]
    assert not any(found)


def test_what_is_found_in_an_image_with_a_fault_is_not_used() -> None:
    clock, nobody = SimulatedClock(1.7e9), Detections("cam01", 0.0, np.zeros((0, 17, 2)), np.zeros((0, 17)))
    camera = LiveCamera("cam01", CameraSource(source="rtsp://x"), clock, late_s=0.5)
    is_used = []
    for frame in [*walker(40), *walker(1, first=40) * 20, *walker(5, first=41)]:
        image = camera.receive(SourceImage(ArrayPicture(frame)))
        assert image is not None
        is_used.append(image.recorded(nobody).is_used)
        clock.advance(1 / FPS)
    # The same picture counts as frozen after 0.45 s, nine images, and for as long as it comes.
    assert all(is_used[:49])
    assert not any(is_used[51:60])
    assert all(is_used[60:])
