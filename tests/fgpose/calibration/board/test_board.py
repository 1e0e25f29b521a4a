"""Descriptions of boards, their files, and drawings in true size."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fgpose.calibration.board.board import load_board, parse_board
from fgpose.calibration.board.detection import opencv_charuco
from fgpose.calibration.board.drawing import board_pdf, largest_square_m, save_board, sheet_of
from fgpose.io.calibration.board_files import board_text

_POINT_MM = 25.4 / 72
# As in the sample of OpenCV's tutorial.
_SETTINGS = """<?xml version="1.0"?>
<opencv_storage>
<Settings>
  <!-- Number of inner corners per a item row and column. (square, circle) -->
  <BoardSize_Width> 9</BoardSize_Width>
  <BoardSize_Height>6</BoardSize_Height>
  <Square_Size>50</Square_Size>
  <Marker_Size>25</Marker_Size>
  <ArUco_Dict_Name>DICT_6X6_250</ArUco_Dict_Name>
  <Calibrate_Pattern>{}</Calibrate_Pattern>
</Settings>
</opencv_storage>"""


@pytest.mark.parametrize(
    "text",
    [
        "charuco:7x5:30mm:22mm:DICT_5X5_100",
        "chessboard:9x6:25mm",
        "circles:4x11:20mm",
        "chessboard:5x4:12.7mm",
        "charuco:7x5:30mm:22mm:DICT_5X5_100:inverted",
    ],
)
def test_a_description_says_all(text: str, tmp_path: Path) -> None:
    board = parse_board(text)
    assert board.text == text
    assert board.inverted is text.endswith(":inverted")
    (tmp_path / "board.toml").write_text(f'board = "{text}"')
    assert load_board(str(tmp_path / "board.toml")) == board
    assert board.points_m.shape == (board.n_points, 3)


def test_units_and_the_default_dictionary() -> None:
    assert parse_board("charuco:7x5:3cm:0.022m").text == "charuco:7x5:30mm:22mm:DICT_4X4_250"
    assert parse_board("chessboard:9x6:1in").square_m == pytest.approx(0.0254)


@pytest.mark.parametrize("text", ["chessboard:9x6:25cm", "charuco:5x7:1m:0.7m", "circles:4x11:30cm"])
@pytest.mark.parametrize("paper", ["A4", "A0"])
def test_what_fits_on_a_paper(text: str, paper: str) -> None:
    board = parse_board(text)
    largest_m = largest_square_m(board, paper)
    for share, fits in ((0.999, True), (1.001, False)):
        square_m = share * largest_m
        marker_m = 0.5 * square_m if board.kind == "charuco" else 0.0
        assert (sheet_of(replace(board, square_m=square_m, marker_m=marker_m)).name == paper) is fits


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("aruco:7x5:30mm", "a board is described as charuco:7x5"),
        ("chesboard:9x6:25mm", "got 'chesboard:9x6:25mm' (did you mean chessboard?)"),
        ("chessboard:9x6", "does not have the parts of a chessboard board"),
        ("chessboard:9:25mm", "columns and rows are written as 7x5, got '9'"),
        ("chessboard:9x6:25", "a length has a unit, as 30mm, 3cm, 0.03m or 1.2in, got '25'"),
        ("chessboard:9x6:25m", "a square measures 1 mm to 2 m, got 25000 mm"),
        ("chessboard:1x6:25mm", "2 to 100 columns and rows"),
        ("charuco:2x2:30mm:20mm", "at least 4 are needed"),
        ("charuco:7x5:30mm:30mm", "a marker is smaller than its square"),
        ("charuco:7x5:30mm:22mm:DICT_5x5_100", "unknown dictionary 'DICT_5x5_100' (did you mean DICT_5X5_100?)"),
        ("charuco:20x20:30mm:22mm:DICT_4X4_50", "has 50 markers, the board needs 200"),
    ],
)
def test_what_is_no_board_is_said(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        parse_board(text)


def test_boards_that_look_the_same_after_half_a_turn() -> None:
    """The truth: whether half a turn maps points, and colours of squares, onto themselves."""
    assert [parse_board(f"chessboard:{size}:25mm").is_ambiguous for size in ("9x6", "8x6", "9x7")] == [0, 1, 1]
    for rows in (10, 11):
        board = parse_board(f"circles:4x{rows}:20mm")
        points = {tuple(point) for point in np.rint(board.points_m[:, :2] / board.square_m).astype(int).tolist()}
        turned = {(7 - x, rows - 1 - y) for x, y in points}
        assert board.is_ambiguous == (points == turned)


@pytest.mark.parametrize(
    ("name", "content", "text"),
    [
        ("board.toml", 'board = "chessboard:9x6:25mm"', "chessboard:9x6:25mm"),
        (
            "Config.toml",
            "[calibration.calculate.intrinsics]\nintrinsics_corners_nb = [4,7]\nintrinsics_square_size = 60 # mm",
            "chessboard:4x7:60mm",
        ),
        (
            "config.toml",
            "[calibration]\nboard_type = 'charuco'\nboard_size = [11, 8]\nboard_marker_bits = 4\n"
            "board_marker_dict_number = 50\nboard_marker_length = 18.75\nboard_square_side_length = 25",
            "charuco:11x8:25mm:18.75mm:DICT_4X4_50",
        ),
        (
            "anipose.toml",
            "[calibration]\nboard_type = 'checkerboard'\nboard_size = [9, 6]\nboard_square_side_length = 0.025",
            "chessboard:9x6:25mm",
        ),
        (
            "caliscope.toml",
            "[charuco]\ncolumns = 4\nrows = 5\nboard_height = 11.0\nboard_width = 8.5\ndictionary = 'DICT_4X4_50'\n"
            "units = 'inch'\naruco_scale = 0.75\nsquare_size_overide_cm = 5.4",
            "charuco:4x5:54mm:40.5mm:DICT_4X4_50",
        ),
        (
            "charuco.toml",
            "columns = 4\nrows = 5\nboard_height = 50.0\nboard_width = 44.0\ndictionary = 'DICT_4X4_50'\n"
            "units = 'cm'\naruco_scale = 0.75",
            "charuco:4x5:100mm:75mm:DICT_4X4_50",
        ),
        (
            "inverted.toml",
            "[charuco]\ncolumns = 4\nrows = 5\ndictionary = 'DICT_4X4_1000'\naruco_scale = 0.75\ninverted = true\n"
            "square_size_overide_cm = 5.4",
            "charuco:4x5:54mm:40.5mm:DICT_4X4_1000:inverted",
        ),
        ("camera.yml", "%YAML:1.0\n---\nboard_width: 9\nboard_height: 6\nsquare_size: 25.", "chessboard:9x6:25mm"),
        (
            "circles.yml",
            '%YAML:1.0\n---\nboard_width: 4\nboard_height: 11\nsquare_size: 20.\npattern: "ASYMMETRIC_CIRCLES_GRID"',
            "circles:4x11:20mm",
        ),
        ("settings.xml", _SETTINGS.format('"CHESSBOARD"'), "chessboard:9x6:50mm"),
        ("charuco.xml", _SETTINGS.format("CHARUCOBOARD"), "charuco:9x6:50mm:25mm:DICT_6X6_250"),
        (
            "out.xml",
            "<opencv_storage><board_width>9</board_width><board_height>6</board_height><square_size>25.</square_size>"
            "</opencv_storage>",
            "chessboard:9x6:25mm",
        ),
    ],
)
def test_boards_of_other_programs(name: str, content: str, text: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(content)
    assert board_text(tmp_path / name) == text
    assert load_board(str(tmp_path / name)).text == text


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("a = 1", "it has no board"),
        ("board = ", "board.toml"),
        ("[calibration]\nboard_type = 'charuco'", "its board is incomplete or damaged: 'board_size'"),
        ("[calibration]\nboard_type = 'dots'\nboard_size=[1,2]\nboard_square_side_length=1", "'dots' is not known"),
        ("[calibration]\nboard_type = 'aruco'\nboard_size=[1,2]", "a board of type 'aruco' is not known: charuco and"),
        ('board = "chessboard:9x6:25"', "a length has a unit"),
        ("<opencv_storage>", "it is damaged or not OpenCV's XML"),
        ("<opencv_storage><a>1</a></opencv_storage>", "it has no board"),
        (_SETTINGS.format("CIRCLES_GRID"), "a board of the pattern 'CIRCLES_GRID' is not known: CHESSBOARD"),
    ],
)
def test_files_without_a_board_are_named(content: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / ("board.xml" if content.startswith("<") else "board.toml")
    path.write_text(content)
    with pytest.raises(ValueError, match=re.escape(message)) as caught:
        load_board(str(path))
    assert path.name in str(caught.value)


@pytest.mark.parametrize("text", ["chessboard:9x6:25mm", "charuco:7x5:30mm:20mm:DICT_4X4_50", "circles:4x11:20mm"])
def test_the_pdf_has_its_true_size(text: str, tmp_path: Path) -> None:
    board = parse_board(text)
    sheet = save_board(board, tmp_path / "board.pdf")
    content = (tmp_path / "board.pdf").read_bytes()
    media = [float(side) for side in re.findall(rb"MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", content)[0]]
    # Four digits of a point are nanometres.
    np.testing.assert_allclose(np.array(media) * _POINT_MM, [1e3 * sheet.width_m, 1e3 * sheet.height_m], atol=1e-3)
    assert sheet.name == "A4"
    if board.kind == "circles":
        centres = np.array(re.findall(rb"([\d.-]+) ([\d.-]+) m [^f]+ c f", content), dtype=float) * _POINT_MM
        offsets = centres - centres[0] - 1e3 * board.points_m[:, :2] * (1, -1)
        np.testing.assert_allclose(offsets, 0, atol=1e-3)
        return
    boxes = np.array(re.findall(rb"([\d.-]+) ([\d.-]+) ([\d.-]+) [\d.-]+ re", content), dtype=float) * _POINT_MM
    squares = boxes[np.isclose(boxes[:, 2], 1e3 * board.square_m, atol=1e-3)]
    assert len(squares) == {"chessboard": 10 * 7 // 2, "charuco": 18}[board.kind]
    steps = np.unique(np.round(np.diff(np.unique(np.round(squares[:, 0], 3))), 2))
    np.testing.assert_allclose(steps, 1e3 * board.square_m, atol=0.01)
    if board.kind == "charuco":
        # A marker has 4 cells and a border of one on either side.
        assert set(np.round(boxes[~np.isclose(boxes[:, 2], 30.0), 2], 3)) == {round(20 / 6, 3)}


@pytest.mark.parametrize("inverted", [False, True])
def test_the_charuco_of_the_pdf_is_opencvs(inverted: bool) -> None:
    """Cell by cell: the drawing as pixels, a millimetre each, against OpenCV's picture."""
    board = replace(parse_board("charuco:7x6:30mm:18mm:DICT_4X4_50"), inverted=inverted)
    drawn, grey, margin = np.full((190, 220), 255, np.uint8), 0, 5
    for x, y, width, height, new_grey in re.findall(
        rb"([\d.-]+) ([\d.-]+) ([\d.-]+) ([\d.-]+) re|([01]) g", board_pdf(board)
    ):
        if new_grey:
            grey = 255 * int(new_grey)
            continue
        left, top, across, along = np.rint(np.array([x, y, width, height], dtype=float) * _POINT_MM).astype(int)
        drawn[margin - top - along : margin - top, margin + left : margin + left + across] = grey
    expected = np.pad(np.asarray(opencv_charuco(board).generateImage((210, 180))), margin, constant_values=255)
    assert (drawn == (255 - expected if inverted else expected)).mean() > 0.999


def test_a_large_board_gets_a_sheet_of_its_own() -> None:
    assert sheet_of(parse_board("chessboard:9x6:150mm")).name == "own size"
    assert sheet_of(parse_board("chessboard:9x6:25mm")).width_m == pytest.approx(0.297)
