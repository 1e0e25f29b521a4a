"""Videos that hold fewer images than their files seem to say, and whether that is said."""

from __future__ import annotations

import struct
import warnings
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import av
import numpy as np
import pytest

from fgpose.geometry.camera import CameraRig
from fgpose.monocular.clips import Clip, open_clip
from fgpose.monocular.detected import Detected
from fgpose.monocular.detection import detect
from fgpose.monocular.edit_list import shown_share
from fgpose.monocular.sources import Sources

if TYPE_CHECKING:
    from tests.fgpose.conftest import SquaresNetwork, SquaresScene

FPS = 25
STEADY_S = np.arange(50) / FPS
VARIABLE_S = np.concatenate([np.arange(15) * 0.06, 0.9 + np.arange(30) * 0.036])


def write(squares: SquaresScene, path: Path, stamps_s: Sequence[float] | np.ndarray) -> Path:
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=FPS, options={"g": "5"})
        stream.width, stream.height, stream.pix_fmt = 320, 240, "yuv420p"
        stream.codec_context.time_base = Fraction(1, 1000)
        for stamp_s in stamps_s:
            frame = av.VideoFrame.from_ndarray(squares.image(0, max(float(stamp_s), 0.0)), format="rgb24")
            frame.pts, frame.time_base = round(stamp_s * 1000), Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def detected(clip: Clip, squares: SquaresScene, network: SquaresNetwork) -> Detected:
    return detect(Sources(CameraRig(squares.rig.cameras[:1]), (replace(clip, name="ring_0"),)), network)


def assert_silent(path: Path, n_images: int, squares: SquaresScene, network: SquaresNetwork) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert detected(open_clip("ring_0", path), squares, network).n_images == n_images


def test_a_variable_rate_is_no_loss(squares: SquaresScene, squares_network: SquaresNetwork, tmp_path: Path) -> None:
    """The number of images of an MKV is guessed from its mean rate."""
    path = write(squares, tmp_path / "a.mkv", VARIABLE_S)
    assert open_clip("a", path).n_images > len(VARIABLE_S) + 3
    assert_silent(path, len(VARIABLE_S), squares, squares_network)


def test_what_is_cut_from_the_beginning_is_no_loss(
    squares: SquaresScene, squares_network: SquaresNetwork, tmp_path: Path
) -> None:
    path = write(squares, tmp_path / "a.mp4", STEADY_S - 12 / FPS)
    assert open_clip("a", path).n_images == 38
    assert_silent(path, 38, squares, squares_network)


def test_what_is_cut_from_the_end_is_no_loss(
    squares: SquaresScene, squares_network: SquaresNetwork, tmp_path: Path
) -> None:
    path = write(squares, tmp_path / "a.mp4", STEADY_S)
    content = bytearray(path.read_bytes())
    duration = content.index(b"elst") + 12
    struct.pack_into(">I", content, duration, struct.unpack_from(">I", content, duration)[0] // 2)
    path.write_bytes(content)
    assert open_clip("a", path).n_images == 25
    assert_silent(path, 25, squares, squares_network)


@pytest.mark.parametrize("stamps_s", [STEADY_S, VARIABLE_S])
def test_a_truncated_video_is_said(
    stamps_s: np.ndarray, squares: SquaresScene, squares_network: SquaresNetwork, tmp_path: Path
) -> None:
    path = write(squares, tmp_path / "a.mkv", stamps_s)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.warns(UserWarning, match=r"a\.mkv: only \d\d of \d\d images can be decoded; from 0\.\d+ s the camera"):
        detected(open_clip("ring_0", path, 100.0), squares, squares_network)


def test_a_video_that_is_damaged_in_the_middle_is_said(
    squares: SquaresScene, squares_network: SquaresNetwork, tmp_path: Path
) -> None:
    path = write(squares, tmp_path / "a.mkv", STEADY_S)
    content = bytearray(path.read_bytes())
    begin, end = (len(content) * share // 10 for share in (4, 6))
    content[begin:end] = bytes(end - begin)
    path.write_bytes(content)
    with pytest.warns(UserWarning, match=r"a\.mkv: only \d\d of 50 images .*; from 0\.\d+ s to 1\.\d+ s the camera"):
        detected(open_clip("ring_0", path), squares, squares_network)


def test_a_damaged_edit_list_is_none(squares: SquaresScene, tmp_path: Path) -> None:
    whole = write(squares, tmp_path / "a.mp4", STEADY_S - 12 / FPS).read_bytes()
    begin = whole.index(b"moov") - 4
    assert shown_share(tmp_path / "a.mp4") == pytest.approx(38 / 50)
    rng = np.random.default_rng(0)
    for _ in range(300):
        content = bytearray(whole)
        for place in rng.integers(begin, len(content), 5):
            content[place] = rng.integers(256)
        (tmp_path / "b.mp4").write_bytes(content[: rng.integers(begin, len(content))])
        assert 0 < shown_share(tmp_path / "b.mp4") <= 1
