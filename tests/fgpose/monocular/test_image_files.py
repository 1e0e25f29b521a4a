"""Folders of images that hold something else, or whose numbers mean something else."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from fgpose.monocular.clips import open_clip
from fgpose.monocular.sources import find_clips, open_sources
from fgpose_benchmarks.synthetic import ring_rig

SIZE_PX = (64, 48)
# EXIF that says that the image is to be turned by 90 degrees.
TURNED = b"MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0"


def grey(size_px: tuple[int, int] = SIZE_PX) -> np.ndarray:
    return np.full((size_px[1], size_px[0], 3), 50, np.uint8)


def write_images(folder: Path, names: Sequence[str]) -> Path:
    folder.mkdir(parents=True)
    for name in names:
        cv2.imwrite(str(folder / name), grey())
    return folder


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".bmp", ".webp", ".tif"])
def test_bad_images_are_named_before_any_work(suffix: str, tmp_path: Path) -> None:
    names = [f"{n}{suffix}" for n in (1, 2, 3)]
    folder = write_images(tmp_path / "a", names)
    assert open_clip("a", folder, 10.0).n_images == 3
    for content in (b"", b"no image at all", (folder / names[1]).read_bytes()[:20]):
        (folder / names[1]).write_bytes(content)
        with pytest.raises(ValueError, match=rf"2\{suffix}: not an image"):
            open_clip("a", folder, 10.0)
    cv2.imwrite(str(folder / names[1]), grey((32, 24)))
    with pytest.raises(ValueError, match=rf"2\{suffix}: the image is 32 x 24, the first is 64 x 48"):
        open_clip("a", folder, 10.0)
    (folder / names[0]).write_bytes(b"")
    with pytest.raises(ValueError, match=rf"1\{suffix}: not an image"):
        open_clip("a", folder, 10.0)


def test_an_image_that_is_damaged_behind_its_header_is_named(tmp_path: Path) -> None:
    folder = write_images(tmp_path / "a", ["1.png", "2.png"])
    (folder / "2.png").write_bytes((folder / "2.png").read_bytes()[:34])
    with pytest.raises(ValueError, match=r"2\.png: not an image"):
        list(open_clip("a", folder, 10.0).pictures())


def test_images_of_several_formats_and_turned_ones_are_of_one_size(tmp_path: Path) -> None:
    folder = write_images(tmp_path / "a", ["1.png", "2.jpg", "3.tif"])
    cv2.imwriteWithMetadata(
        str(folder / "4.jpg"), grey((48, 64)), [cv2.IMAGE_METADATA_EXIF], [np.frombuffer(TURNED, np.uint8)]
    )
    clip = open_clip("a", folder, 10.0)
    assert [picture.image.shape for picture in clip.pictures()] == [(48, 64, 3)] * 4


def test_images_whose_headers_are_not_known_are_not_all_decoded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = write_images(tmp_path / "a", ["1.png", "2.png", "3.png"])
    monkeypatch.setattr("imagesize.get", lambda file: (-1, -1))
    decoded = list[Path]()
    for module in ("clips", "image_files"):
        monkeypatch.setattr(f"fgpose.monocular.{module}.read_image", lambda file: decoded.append(file) or grey())
    open_clip("a", folder, 10.0)
    assert [file.name for file in decoded] == ["1.png"]


def test_images_that_may_be_numbered_by_milliseconds_are_announced_once(tmp_path: Path) -> None:
    rig = ring_rig(3, size_px=SIZE_PX)
    for name in rig.names:
        write_images(tmp_path / name, [f"frame_{n:06d}.png" for n in (0, 40, 80, 120)])
    said = (
        r"numbers of the images go up by 40: taken as 0\.625 images a second; if they are milliseconds, give --fps 1000"
    )
    for opened in (lambda fps: open_sources(tmp_path, rig, fps=fps), lambda fps: find_clips(tmp_path, fps=fps)):
        with pytest.warns(UserWarning, match=said) as caught:
            opened(25.0)
        assert len(caught) == 1
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            opened(1000.0)


def test_numbers_that_go_up_by_more_in_one_camera_are_frames(tmp_path: Path) -> None:
    """It kept every eighth image. Images of a board have no times at all."""
    write_images(tmp_path / "a", ["0.png", "8.png", "16.png"])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        (board,) = find_clips(tmp_path, fps_of_images=1.0)
        write_images(tmp_path / "b", ["0.png", "2.png", "4.png"])
        clips = find_clips(tmp_path, fps=60.0)
    assert board.taken_s().tolist() == [0, 8, 16]
    assert [clip.fps for clip in clips] == [7.5, 30]
