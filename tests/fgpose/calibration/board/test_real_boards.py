"""A real chessboard before a real pair of cameras, against OpenCV's calibration and against itself."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import real_boards
from fgpose.calibration.board.board import load_board
from fgpose.calibration.board.calibrate import calibrate_from_boards
from fgpose.calibration.board.filmed import find_boards
from fgpose.calibration.board.sightings import BoardSightings
from fgpose.cli import main
from fgpose.io.calibration import load_intrinsics, load_rig

FOLDER, BOARD = real_boards.IMAGES, real_boards.BOARD


@pytest.fixture(scope="module")
def sightings() -> BoardSightings:
    return find_boards(FOLDER, load_board(BOARD))


def test_images_become_the_rig_that_opencv_finds(
    sightings: BoardSightings, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["calibrate", str(FOLDER), "--board", BOARD, "-o", str(tmp_path / "rig.toml"), "--no-rrd"]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "at 13 moments" in printed
    assert "by so much do the moments disagree" in printed
    rig = load_rig(tmp_path / "rig.toml")
    left_K, _, right_K, _, _, translation = real_boards.by_opencv(sightings)
    focal_px = [np.diag(K)[:2].mean() for K in (left_K, right_K)]
    distance_m = np.linalg.norm(translation)
    # Least squares, which has no kernel against the view that is badly lit: 0.3 % of the focal length, 0.3 mm.
    np.testing.assert_allclose(rig.focal_px, focal_px, rtol=0.005)
    assert np.linalg.norm(np.diff(rig.positions_m, axis=0)) == pytest.approx(distance_m, rel=0.005)
    published = load_intrinsics(FOLDER / "left_intrinsics.yml", ("left",))
    np.testing.assert_allclose(rig.focal_px[:1], published.focal_px, rtol=0.005)


@pytest.mark.slow
def test_halves_of_the_views_agree_within_what_both_state(sightings: BoardSightings) -> None:
    squares = []
    for seed in range(8):
        one, other = (calibrate_from_boards(half) for half in real_boards.halves(sightings, seed))
        squares.append(real_boards.in_sigmas(one, other) ** 2)
    # 1 is right, and the noise of the corners alone would make it 2.2.
    assert 0.7 < np.sqrt(np.mean(squares)) < 1.4


@pytest.mark.slow
def test_the_benchmark(capsys: pytest.CaptureFixture[str]) -> None:
    real_boards.main(["--splits", "1"])
    rms_px = [float(line.split("RMS ")[1].split()[0]) for line in capsys.readouterr().out.splitlines()[:2]]
    # On views that neither has seen, no worse than OpenCV.
    assert rms_px[0] < 1.02 * rms_px[1]
