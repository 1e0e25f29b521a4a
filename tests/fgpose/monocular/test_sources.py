from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from fgpose.correspondences import NO_IMAGE, match_frames
from fgpose.geometry.camera import Camera
from fgpose.geometry.fitted_camera import fitted_camera
from fgpose.monocular.clips import open_clip
from fgpose.monocular.sources import find_clips, open_sources

if TYPE_CHECKING:
    from tests.fgpose.conftest import SquaresScene

SIZE_PX = (64, 48)
Writer = Callable[[Path, list[np.ndarray], float], Path]


def grey(level: int, size_px: tuple[int, int] = SIZE_PX) -> np.ndarray:
    return np.full((size_px[1], size_px[0], 3), level, np.uint8)


def camera(size_px: tuple[int, int] = SIZE_PX) -> Camera:
    K = np.array([[50.0, 0.0, 31.0], [0.0, 52.0, 23.0], [0.0, 0.0, 1.0]])
    return Camera("cam_1", size_px, K, np.eye(4), np.array([0.1, 0.0, 0.0, 0.0]))


def write_images(folder: Path, names: list[str], levels: list[int]) -> Path:
    folder.mkdir(parents=True)
    for name, level in zip(names, levels, strict=True):
        cv2.imwrite(str(folder / name), grey(level))
    return folder


# --- one camera ---


def test_a_folder_of_nothing_but_images_is_one_camera(tmp_path: Path) -> None:
    folder = write_images(tmp_path / "left", ["1.png", "2.png"], [20, 60])
    (clip,) = find_clips(folder, fps=25.0)
    assert (clip.name, clip.n_images) == ("left", 2)


def test_a_video_is_probed_and_read_in_order(tmp_path: Path, video_writer: Writer) -> None:
    levels = [20, 60, 100, 140, 180]
    clip = open_clip("a", video_writer(tmp_path / "a.mp4", [grey(level) for level in levels], 25.0))
    assert (clip.size_px, clip.n_images, clip.fps) == (SIZE_PX, 5, 25.0)
    pictures = list(clip.pictures())
    assert [picture.number for picture in pictures] == [0, 1, 2, 3, 4]
    # The codec is lossy; the next level is 40 away.
    np.testing.assert_allclose([picture.image.mean() for picture in pictures], levels, atol=5)
    times_s = clip.times_s(np.array([picture.stamp_s for picture in pictures]))
    np.testing.assert_allclose(times_s, np.arange(5) / 25, atol=1e-9)


def test_reading_may_begin_later(tmp_path: Path, video_writer: Writer) -> None:
    clip = open_clip("a", video_writer(tmp_path / "a.mp4", [grey(level) for level in (20, 60, 100, 140)], 25.0))
    (picture,) = clip.pictures(3)
    assert picture.number == 3
    assert abs(picture.image.mean() - 140) < 5
    assert picture.stamp_s == pytest.approx(0.12)
    assert list(clip.pictures(9)) == []


def test_images_are_rgb(tmp_path: Path, video_writer: Writer) -> None:
    red = np.zeros((48, 64, 3), np.uint8)
    red[..., 0] = 200
    video = open_clip("a", video_writer(tmp_path / "a.mp4", [red], 25.0))
    folder = tmp_path / "images"
    folder.mkdir()
    cv2.imwrite(str(folder / "1.png"), cv2.cvtColor(red, cv2.COLOR_RGB2BGR))
    for clip in (video, open_clip("b", folder, 25.0)):
        (picture,) = clip.pictures()
        # Compression shifts colours by a few levels.
        np.testing.assert_allclose(picture.image.mean(axis=(0, 1)), (200, 0, 0), atol=12)


def test_the_users_frame_rate_overrides_that_of_the_video(tmp_path: Path, video_writer: Writer) -> None:
    clip = open_clip("a", video_writer(tmp_path / "a.mp4", [grey(50)] * 4, 25.0), 120.0)
    stamps_s = np.array([picture.stamp_s for picture in clip.pictures()])
    assert clip.fps == 120.0
    np.testing.assert_allclose(clip.times_s(stamps_s), np.arange(4) / 120)


def test_stamps_are_read_without_decoding(tmp_path: Path, video_writer: Writer) -> None:
    clip = open_clip("a", video_writer(tmp_path / "a.mp4", [grey(level) for level in (20, 60, 100, 140)], 25.0))
    np.testing.assert_array_equal(clip.stamps_s(), [picture.stamp_s for picture in clip.pictures()])
    np.testing.assert_allclose(clip.stamps_s(), np.arange(4) / 25)
    folder = write_images(tmp_path / "b", ["1.png", "2.png"], [10, 20])
    np.testing.assert_array_equal(open_clip("b", folder, 10.0).stamps_s(), [np.nan, np.nan])


def test_images_come_in_natural_order_at_the_times_of_their_numbers(tmp_path: Path) -> None:
    # Frame 3 was dropped.
    folder = write_images(tmp_path / "a", ["f2.png", "f10.png", "f1.png", "f4.png"], [20, 100, 10, 40])
    (folder / "notes.txt").touch()
    clip = open_clip("a", folder, 10.0)
    assert [int(picture.image.mean()) for picture in clip.pictures()] == [10, 20, 40, 100]
    np.testing.assert_allclose(clip.times_s(np.full(4, np.nan)), [0.1, 0.2, 0.4, 1.0])
    np.testing.assert_allclose(clip.times_s(np.full(2, np.nan)), [0.1, 0.2])


def test_images_without_numbers_count_from_0(tmp_path: Path) -> None:
    clip = open_clip("a", write_images(tmp_path / "a", ["a_v2.png", "b_v2.png"], [10, 20]), 10.0)
    np.testing.assert_allclose(clip.times_s(np.full(2, np.nan)), [0.0, 0.1])


def test_every_second_image_makes_half_the_rate(tmp_path: Path) -> None:
    clip = open_clip("a", write_images(tmp_path / "a", ["0.png", "2.png", "4.png"], [1, 2, 3]), 60.0)
    assert clip.fps == 30.0
    assert clip.end_s == pytest.approx(4 / 60 + 1 / 30)


def test_a_single_frame_video_is_a_clip(tmp_path: Path, video_writer: Writer) -> None:
    clip = open_clip("a", video_writer(tmp_path / "a.mp4", [grey(50)], 25.0))
    assert len(list(clip.pictures())) == clip.n_images == 1


@pytest.mark.parametrize("content", [b"", b"not a video at all" * 100, "truncated"])
def test_a_damaged_video_is_named(content: bytes | str, tmp_path: Path, video_writer: Writer) -> None:
    path = video_writer(tmp_path / "cam.mp4", [grey(50)] * 20, 25.0)
    path.write_bytes(path.read_bytes()[:500] if isinstance(content, str) else content)
    with pytest.raises(ValueError, match=r"cam\.mp4: .*(empty|damaged)"):
        open_clip("cam", path)


def test_images_need_a_frame_rate(tmp_path: Path) -> None:
    folder = write_images(tmp_path / "a", ["1.png"], [1])
    with pytest.raises(ValueError, match="--fps"):
        open_clip("a", folder)
    for fps in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ValueError, match="fps must be a positive number"):
            open_clip("a", folder, fps)


def test_numbers_that_are_no_frame_numbers_are_refused(tmp_path: Path) -> None:
    folder = write_images(tmp_path / "a", ["1700000000.png", "1700033333.png"], [1, 2])
    with pytest.raises(ValueError, match="not frame numbers"):
        open_clip("a", folder, 30.0)


def test_the_fingerprint_follows_the_content(tmp_path: Path, video_writer: Writer) -> None:
    clip = open_clip("a", video_writer(tmp_path / "a.mp4", [grey(50)] * 5, 25.0))
    same = open_clip("b", video_writer(tmp_path / "b.mp4", [grey(50)] * 5, 25.0))
    other = open_clip("c", video_writer(tmp_path / "c.mp4", [grey(51)] * 5, 25.0))
    assert clip.fingerprint() == same.fingerprint() != other.fingerprint()
    folder = write_images(tmp_path / "d", ["1.png", "2.png"], [1, 2])
    before = open_clip("d", folder, 10.0).fingerprint()
    cv2.imwrite(str(folder / "2.png"), grey(3))
    assert open_clip("d", folder, 10.0).fingerprint() != before


# --- the cameras of a rig ---


def test_videos_are_found_by_the_names_of_the_cameras(squares: SquaresScene, tmp_path: Path) -> None:
    squares.write_video(tmp_path / "Ring2.mp4", 2, 4)
    squares.write_video(tmp_path / "ring-0.avi", 0, 4)
    (tmp_path / "README.txt").touch()
    # One camera as images, one as a video in a folder of its own.
    (tmp_path / "ring_1").mkdir()
    for n in range(4):
        cv2.imwrite(str(tmp_path / "ring_1" / f"{n}.png"), squares.image(1, n / 20))
    (tmp_path / "ring_1" / ".hidden.png").touch()
    sources = open_sources(tmp_path, squares.rig, fps=20.0)
    assert [clip.path.name for clip in sources.clips] == ["ring-0.avi", "ring_1", "Ring2.mp4"]
    assert sources.rig.names == squares.rig.names
    assert all(len(list(clip.pictures())) == 4 for clip in sources.clips)
    assert sources.fps == 20.0


def test_a_folder_may_hold_the_video(squares: SquaresScene, tmp_path: Path) -> None:
    for c, name in enumerate(squares.rig.names):
        squares.write_video(tmp_path / name / "recording.mp4", c, 2)
        # As macOS leaves them on other disks.
        (tmp_path / name / "._recording.mp4").write_bytes(b"Mac OS X")
    assert [clip.name for clip in open_sources(tmp_path, squares.rig).clips] == list(squares.rig.names)


def test_a_single_camera_may_be_a_single_file(squares: SquaresScene, tmp_path: Path) -> None:
    path = squares.write_video(tmp_path / "ring_1.mp4", 1, 2)
    assert open_sources(path, squares.rig, cameras=("ring_1",)).rig.names == ("ring_1",)


def test_some_cameras_only(squares: SquaresScene, tmp_path: Path) -> None:
    folder = squares.write_all(tmp_path, 2)
    sources = open_sources(folder, squares.rig, cameras=("ring_2", "ring_0"))
    assert [clip.path.stem for clip in sources.clips] == ["ring_2", "ring_0"]
    (folder / "ring_1.mp4").unlink()
    sources = open_sources(folder, squares.rig, cameras=("ring_2", "ring_0"))
    assert sources.rig.names == ("ring_2", "ring_0")
    with pytest.raises(ValueError, match="ring_9"):
        open_sources(folder, squares.rig, cameras=("ring_9",))


def test_cameras_that_do_not_match_are_named(squares: SquaresScene, tmp_path: Path) -> None:
    squares.write_all(tmp_path, 2)
    (tmp_path / "ring_1.mp4").rename(tmp_path / "ring_7.mp4")
    names = r"videos \(ring_0, ring_2, ring_7\) and .*calibration \(ring_0, ring_1, ring_2\)"
    with pytest.raises(ValueError, match=names) as error:
        open_sources(tmp_path, squares.rig)
    assert str(tmp_path) in str(error.value)


def test_a_folder_without_videos_says_what_is_expected(squares: SquaresScene, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match=r"no videos; expected one video per camera"):
        open_sources(tmp_path, squares.rig)
    with pytest.raises(FileNotFoundError):
        open_sources(tmp_path / "nowhere", squares.rig)


def test_two_videos_of_one_camera_are_refused(squares: SquaresScene, tmp_path: Path) -> None:
    squares.write_all(tmp_path, 2)
    (tmp_path / "ring_1.avi").write_bytes(b"x")
    with pytest.raises(ValueError, match=r"camera ring_1 has ring_1\.avi beside it"):
        open_sources(tmp_path, squares.rig)


def test_a_video_that_ends_early_is_announced(squares: SquaresScene, tmp_path: Path) -> None:
    squares.write_all(tmp_path, 20)
    squares.write_video(tmp_path / "ring_1.mp4", 1, 8)
    with pytest.warns(UserWarning, match=r"ring_1\.mp4: ends after 0\.40 s, 0\.60 s before the others"):
        open_sources(tmp_path, squares.rig)


# --- images whose size is not that of the calibration ---


def test_the_same_size_keeps_the_camera() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert fitted_camera(camera(), SIZE_PX, "a.mp4").K is not None


@pytest.mark.parametrize("size_px", [(1080, 1920), (1088, 1920), (1104, 1912)])
def test_what_an_encoder_cuts_or_pads_leaves_the_pixels_in_place(size_px: tuple[int, int]) -> None:
    original = replace(camera(), size_px=(1096, 1920))
    with pytest.warns(UserWarning, match=r"a\.mp4, camera cam_1: the images are .* cut or padded on the right"):
        fitted = fitted_camera(original, size_px, "a.mp4")
    assert fitted.size_px == size_px
    np.testing.assert_array_equal(fitted.K, original.K)


def test_a_resized_video_resizes_the_intrinsics() -> None:
    """A point is where resizing the image puts it."""
    original = replace(camera(), size_px=(640, 480), K=np.array([[500.0, 0, 300], [0, 510, 250], [0, 0, 1]]))
    with pytest.warns(UserWarning, match=r"resized by 0\.5 x 0\.5"):
        half = fitted_camera(original, (320, 240), "a.mp4")
    point_m = np.array([[0.2, -0.1, 1.0]])
    full_px, half_px = (view.distort(view.project(point_m))[0] for view in (original, half))
    image = np.zeros((480, 640), np.float32)
    row, column = np.round(full_px[::-1]).astype(int)
    image[row, column] = 1.0
    small = cv2.resize(image, (320, 240), interpolation=cv2.INTER_AREA)
    assert np.unravel_index(small.argmax(), small.shape) == tuple(np.round(half_px[::-1]).astype(int))
    # Pixel corners are what is scaled: x' + 1/2 = (x + 1/2) / 2.
    np.testing.assert_allclose(half_px + 0.5, (full_px + 0.5) / 2, atol=1e-9)


@pytest.mark.parametrize("size_px", [(480, 640), (640, 440), (500, 480)])
def test_a_size_that_cannot_be_explained_is_refused(size_px: tuple[int, int]) -> None:
    with pytest.raises(ValueError, match=r"a\.mp4, camera cam_1: the images are .*calibrate the camera with images"):
        fitted_camera(camera((640, 480)), size_px, "a.mp4")


def test_the_rig_of_the_sources_is_that_of_the_images(squares: SquaresScene, tmp_path: Path) -> None:
    squares.write_all(tmp_path, 2)
    cameras = squares.rig.cameras
    rig = type(squares.rig)((replace(cameras[0], size_px=(328, 240)), *cameras[1:]))
    with pytest.warns(UserWarning, match=r"ring_0\.mp4, camera ring_0: the images are 320 x 240"):
        sources = open_sources(tmp_path, rig)
    assert [view.size_px for view in sources.rig.cameras] == [(320, 240)] * 3


# --- frames ---


def test_cameras_of_one_rate_share_their_frames() -> None:
    frames = match_frames([np.arange(5) / 50, np.arange(3) / 50, np.zeros(0)])
    np.testing.assert_allclose(frames.time_s, np.arange(5) / 50)
    np.testing.assert_array_equal(frames.image[:, 0], np.arange(5))
    np.testing.assert_array_equal(frames.image[:, 1], [0, 1, 2, NO_IMAGE, NO_IMAGE])
    assert (frames.image[:, 2] == NO_IMAGE).all()


def test_a_slower_camera_is_missing_in_between() -> None:
    frames = match_frames([np.arange(4) / 30, np.arange(8) / 60])
    np.testing.assert_allclose(frames.time_s, np.arange(8) / 60)
    np.testing.assert_array_equal(frames.image[:, 1], np.arange(8))
    np.testing.assert_array_equal(frames.image[:, 0], [0, NO_IMAGE, 1, NO_IMAGE, 2, NO_IMAGE, 3, NO_IMAGE])


@pytest.mark.parametrize("other_fps", [25.0, 29.97, 48.0, 59.94])
def test_each_frame_has_the_nearest_image_within_half_a_frame(other_fps: float) -> None:
    fast_s, slow_s = np.arange(300) / 60, np.arange(int(5 * other_fps)) / other_fps
    frames = match_frames([fast_s, slow_s])
    np.testing.assert_array_equal(frames.image[:, 0], np.arange(300))
    assert frames.time_s.shape == (300, 2)
    used = frames.image[:, 1]
    for t, image in enumerate(used.tolist()):
        distance_s = np.abs(slow_s - fast_s[t])
        if image != NO_IMAGE:
            assert image == distance_s.argmin()
            assert frames.time_s[t, 1] == slow_s[image]
        # A tenth of a frame is left for rounded stamps.
        assert (distance_s.min() <= 0.6 / 60) >= (image != NO_IMAGE)
        assert image != NO_IMAGE or distance_s.min() >= 0.4 / 60
    assert len(set(used[used != NO_IMAGE].tolist())) == (used != NO_IMAGE).sum()


def test_other_cameras_carry_on_where_the_fastest_is_missing() -> None:
    """It begins late, drops an image and ends early."""
    fast_s = np.array([0.2, 0.25, 0.35, 0.4])
    slow_s = np.arange(7) / 10
    frames = match_frames([fast_s, slow_s])
    np.testing.assert_allclose(frames.time_s, [0.0, 0.1, 0.2, 0.25, 0.3, 0.35, 0.4, 0.5, 0.6])
    np.testing.assert_array_equal(frames.image[:, 1], [0, 1, 2, NO_IMAGE, 3, NO_IMAGE, 4, 5, 6])
    np.testing.assert_array_equal(frames.image[:, 0], [NO_IMAGE, NO_IMAGE, 0, 1, NO_IMAGE, 2, 3, NO_IMAGE, NO_IMAGE])


def test_cameras_that_are_not_triggered_together_keep_their_clocks() -> None:
    frames = match_frames([np.arange(4) / 50, np.arange(4) / 50 + 0.004])
    assert frames.time_s.shape == (4, 2)
    np.testing.assert_allclose(frames.time_s[:, 1] - frames.time_s[:, 0], 0.004)


def test_stamps_rounded_to_milliseconds_are_one_clock() -> None:
    exact_s = np.arange(200) / 60
    frames = match_frames([exact_s, np.round(exact_s, 3)])
    np.testing.assert_array_equal(frames.image, np.repeat(np.arange(200)[:, None], 2, axis=1))
    assert frames.time_s.ndim == 1


def test_no_image_at_all_is_refused() -> None:
    with pytest.raises(ValueError, match="no camera has an image"):
        match_frames([np.zeros(0), np.zeros(0)])


def test_single_images_make_one_frame_if_they_are_together() -> None:
    frames = match_frames([np.array([0.0]), np.array([0.0])])
    np.testing.assert_array_equal(frames.image, [[0, 0]])
