"""Films of videos as phones write them: turned by what the file says, and of a variable rate."""

from __future__ import annotations

import struct
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from jaxtyping import UInt8

import fgpose
from fgpose.cli import main
from fgpose_benchmarks.synthetic import ring_rig
from tests.fgpose.conftest import SquaresScene, write_video
from tests.fgpose.overlay.test_overlay import FPS, film, is_drawn, trajectory


def write_turned(path: Path, images: list[UInt8[np.ndarray, "height width 3"]]) -> None:
    """As a phone that is held upright does: the pixels lie on their side, and the file says by how much they are to be
    turned."""
    write_video(path, [np.ascontiguousarray(np.rot90(image)) for image in images], FPS)
    content = path.read_bytes()
    # Of the header of the track: version, times, number, duration, layer and volume are before its matrix.
    matrix = content.index(b"tkhd") + 44
    assert struct.unpack_from(">9i", content, matrix) == (1 << 16, 0, 0, 0, 1 << 16, 0, 0, 0, 1 << 30)
    quarter = struct.pack(">9i", 0, 1 << 16, 0, -1 << 16, 0, 0, 0, 0, 1 << 30)
    path.write_bytes(content[:matrix] + quarter + content[matrix + len(quarter) :])


def write_variable(path: Path, images: list[UInt8[np.ndarray, "height width 3"]], stamps_s: np.ndarray) -> None:
    """Of a rate that changes, as phones have in the dark."""
    import av

    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=30)
        stream.height, stream.width, stream.pix_fmt = *images[0].shape[:2], "yuv420p"
        stream.codec_context.time_base = Fraction(1, 1000)
        for image, stamp_s in zip(images, stamps_s, strict=True):
            frame = av.VideoFrame.from_ndarray(image, format="rgb24")
            frame.pts, frame.time_base = round(1000 * stamp_s), Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def upright() -> SquaresScene:
    return SquaresScene(ring_rig(3, 4.0, 1.7, focal_px=300.0, size_px=(240, 320)))


@pytest.mark.parametrize("together", [False, True])
def test_a_portrait_video_is_upright_and_the_person_on_it(tmp_path: Path, together: bool) -> None:
    portrait = upright()
    fgpose.save_rig(portrait.rig, tmp_path / "rig.toml")
    fgpose.save_trajectory(trajectory(portrait, 8), tmp_path / "pose.npz")
    (tmp_path / "walk").mkdir()
    for n, name in enumerate(portrait.rig.names):
        write_turned(tmp_path / "walk" / f"{name}.mp4", [portrait.image(n, image / FPS) for image in range(8)])
    files = [str(tmp_path / name) for name in ("pose.npz", "walk")]
    how = ["--width", "1448"] if together else ["--each", "--width", "480"]
    options = ["--rig", str(tmp_path / "rig.toml"), "--no-ellipses", *how, "-o", str(tmp_path / "film.mp4")]
    assert main(["overlay", *files, *options]) == 0
    for n, camera in enumerate(portrait.rig.cameras):
        _, images = film(tmp_path / ("film.mp4" if together else f"film_{camera.name}.mp4"))
        assert images[0].shape == (640, 1448 if together else 480, 3)
        begin_px = np.array([484.0 * n if together else 0.0, 0.0])
        for point_px in camera.project(portrait.positions_m(4 / FPS)[0]):
            assert is_drawn(images[4], 2 * point_px + begin_px), camera.name


@pytest.mark.parametrize("width_px", [14, 100, 113, 245])
def test_images_fit_into_a_grid_of_any_width(tmp_path: Path, width_px: int) -> None:
    portrait = upright()
    fgpose.save_rig(portrait.rig, tmp_path / "rig.toml")
    fgpose.save_trajectory(trajectory(portrait, 2), tmp_path / "pose.npz")
    (tmp_path / "walk").mkdir()
    for n, name in enumerate(portrait.rig.names):
        write_video(tmp_path / "walk" / f"{name}.mp4", [portrait.image(n, 0.0)] * 2, FPS)
    files = [str(tmp_path / name) for name in ("pose.npz", "walk")]
    options = ["--rig", str(tmp_path / "rig.toml"), "--width", str(width_px), "-o", str(tmp_path / "film.mp4")]
    assert main(["overlay", *files, *options]) == 0
    assert abs(film(tmp_path / "film.mp4")[1][0].shape[1] - width_px) <= 4


@pytest.mark.parametrize("extension", ["mp4", "mkv"])
def test_images_of_a_variable_rate_are_shown_when_they_were_taken(
    squares: SquaresScene, tmp_path: Path, extension: str
) -> None:
    stamps_s = np.concatenate([np.arange(6) * 0.1, 0.6 + np.arange(12) * 0.033])
    images = [squares.image(0, float(stamp_s)) for stamp_s in stamps_s]
    (tmp_path / "walk").mkdir()
    write_variable(tmp_path / "walk" / f"ring_0.{extension}", images, stamps_s)
    fgpose.save_rig(squares.rig.subset(["ring_0"]), tmp_path / "rig.toml")
    fgpose.save_trajectory(trajectory(squares, 20), tmp_path / "pose.npz")
    files = [str(tmp_path / name) for name in ("pose.npz", "walk")]
    options = ["--rig", str(tmp_path / "rig.toml"), "--no-ellipses", "--width", "640", "-o", str(tmp_path / "film.mp4")]
    assert main(["overlay", *files, *options, "--each"]) == 0
    shown_s, drawn = film(tmp_path / "film_ring_0.mp4")
    np.testing.assert_allclose(shown_s, stamps_s, atol=1e-3)
    for number in (2, 7, 15):
        for point_px in squares.rig.cameras[0].project(squares.positions_m(float(stamps_s[number]))[0]):
            assert is_drawn(drawn[number], 2 * point_px), number


def test_exchanged_videos_and_result_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "videos").mkdir()
    (tmp_path / "result.parquet").write_bytes(b"PAR1")
    videos, result = str(tmp_path / "videos"), str(tmp_path / "result.parquet")
    assert main(["overlay", videos, result, "-o", str(tmp_path / "x.mp4")]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert f"{videos} is a folder; first comes the result, then the videos: fgpose overlay {result} {videos}" in said
