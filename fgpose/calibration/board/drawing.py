"""A board as a PDF in its true size, drawn as lines and not as pixels, so that it is exact on any printer."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fgpose.calibration.board.board import Board

# The units of PDF are points, 72 an inch. DIN sizes, the smallest first; larger boards get a sheet of their own.
_POINT_M = 0.0254 / 72
_SHEETS_M = {
    "A4": (0.210, 0.297),
    "A3": (0.297, 0.420),
    "A2": (0.420, 0.594),
    "A1": (0.594, 0.841),
    "A0": (0.841, 1.189),
}
PAPERS = tuple(_SHEETS_M)
_MARGIN_M = 0.01  # what printers leave white, and detectors need around the board
_TEXT_M = 0.004
_RULER_M = 0.1
# Of the control points of a quarter of a circle by a cubic curve; off by 0.03 % of the radius.
_CIRCLE = 0.5523
# Radius of a circle as a share of the spacing of the rows: neighbours are sqrt(2) spacings apart.
_RADIUS = 0.45


@dataclass(frozen=True)
class Sheet:
    """The paper that a board is drawn on."""

    name: str
    """As A3; "own size" where none is large enough."""
    width_m: float
    height_m: float


def sheet_of(board: Board) -> Sheet:
    """The smallest that holds it."""
    width_m, height_m = (side + 2 * _MARGIN_M for side in _extent_m(board))
    height_m += 2 * _TEXT_M
    for name, (short_m, long_m) in _SHEETS_M.items():
        for sheet in (Sheet(name, long_m, short_m), Sheet(name, short_m, long_m)):
            if width_m <= sheet.width_m and height_m <= sheet.height_m:
                return sheet
    return Sheet("own size", width_m, height_m)


def largest_square_m(board: Board, paper: str) -> float:
    """With squares, or a spacing of circles, of this side the board would just fit on A4 to A0."""
    width_m, height_m = _extent_m(board)
    short_m, long_m = _SHEETS_M[paper]
    shares = (
        min((across_m - 2 * _MARGIN_M) / width_m, (along_m - 2 * _MARGIN_M - 2 * _TEXT_M) / height_m)
        for across_m, along_m in ((short_m, long_m), (long_m, short_m))
    )
    return board.square_m * max(shares)


def board_pdf(board: Board) -> bytes:
    """The file: one page with the board in its middle, and below it what it is and a ruler of 10 cm."""
    sheet = sheet_of(board)
    width_m, height_m = _extent_m(board)
    left_m, top_m = (sheet.width_m - width_m) / 2, (sheet.height_m + height_m) / 2 + _TEXT_M
    shapes = [f"1 0 0 1 {left_m / _POINT_M:.4f} {top_m / _POINT_M:.4f} cm", *_ground(board), *_shapes(board), "0 g"]
    below_pt = -(height_m + _MARGIN_M / 2 + _TEXT_M) / _POINT_M
    label = f"{board.text}  print at 100 %; the line measures 100 mm"
    ruler_pt = _RULER_M / _POINT_M
    shapes += [f"BT /F1 {_TEXT_M / _POINT_M / 1.4:.2f} Tf 0 {below_pt:.4f} Td ({label}) Tj ET"]
    shapes += [f"0.7 w 0 {below_pt - 3:.4f} m {ruler_pt:.4f} {below_pt - 3:.4f} l S"]
    media = f"[0 0 {sheet.width_m / _POINT_M:.4f} {sheet.height_m / _POINT_M:.4f}]"
    return _document("\n".join(shapes).encode("ascii"), media)


def save_board(board: Board, path: str | Path) -> Sheet:
    """Write the PDF. Returns the paper it needs. Raises OSError if it cannot be written."""
    from fgpose.io.atomic import write_bytes

    write_bytes(Path(path), board_pdf(board))
    return sheet_of(board)


def _extent_m(board: Board) -> tuple[float, float]:
    """Width and height of what is printed."""
    columns, rows = board.size
    if board.kind == "charuco":
        return columns * board.square_m, rows * board.square_m
    if board.kind == "chessboard":
        return (columns + 1) * board.square_m, (rows + 1) * board.square_m
    return 2 * columns * board.square_m, (rows + 1) * board.square_m


def _ground(board: Board) -> Iterator[str]:
    """Of an inverted board: black to halfway into the margin, for detectors need it around the board; white on it."""
    if board.inverted:
        width_m, height_m = _extent_m(board)
        yield _rectangle(-_MARGIN_M / 2, -_MARGIN_M / 2, width_m + _MARGIN_M, height_m + _MARGIN_M)
        yield "1 g"


def _shapes(board: Board) -> Iterator[str]:
    """In points, from the upper left corner of the board."""
    if board.kind == "circles":
        centres_m = board.points_m[:, :2] + board.square_m * np.array([0.5, 1.0])
        for x_m, y_m in centres_m.tolist():
            yield _circle(x_m, y_m, _RADIUS * board.square_m)
        return
    extra = 0 if board.kind == "charuco" else 1
    columns, rows = board.size[0] + extra, board.size[1] + extra
    markers = _markers(board)
    for row in range(rows):
        for column in range(columns):
            x_m, y_m = column * board.square_m, row * board.square_m
            # A chessboard begins with a white square: its first corner is then at the upper left, as detected.
            if (row + column) % 2 == extra:
                yield _box(x_m, y_m, board.square_m)
            elif board.kind == "charuco":
                yield from _marker(next(markers), x_m, y_m, board)


def _markers(board: Board) -> Iterator[np.ndarray]:
    """Of charuco, in order: cells that are black, with the border."""
    if board.kind != "charuco":
        return
    import cv2

    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    n_cells = dictionary.markerSize + 2
    for number in range(board.size[0] * board.size[1] // 2):
        yield np.asarray(cv2.aruco.generateImageMarker(dictionary, number, n_cells)) == 0


def _marker(black: np.ndarray, x_m: float, y_m: float, board: Board) -> Iterator[str]:
    cell_m, inset_m = board.marker_m / len(black), (board.square_m - board.marker_m) / 2
    for row, column in np.argwhere(black).tolist():
        yield _box(x_m + inset_m + column * cell_m, y_m + inset_m + row * cell_m, cell_m)


def _box(x_m: float, y_m: float, side_m: float) -> str:
    return _rectangle(x_m, y_m, side_m, side_m)


def _rectangle(x_m: float, y_m: float, width_m: float, height_m: float) -> str:
    x, y, width, height = (length_m / _POINT_M for length_m in (x_m, y_m, width_m, height_m))
    return f"{x:.4f} {-y - height:.4f} {width:.4f} {height:.4f} re f"


def _circle(x_m: float, y_m: float, radius_m: float) -> str:
    x, y, r = x_m / _POINT_M, -y_m / _POINT_M, radius_m / _POINT_M
    corners = [(1, 0), (0, 1), (-1, 0), (0, -1), (1, 0)]
    path = [f"{x + r:.4f} {y:.4f} m"]
    for (ax, ay), (bx, by) in itertools.pairwise(corners):
        controls = (ax + _CIRCLE * bx, ay + _CIRCLE * by, bx + _CIRCLE * ax, by + _CIRCLE * ay, bx, by)
        path.append(" ".join(f"{centre + r * c:.4f}" for centre, c in zip((x, y) * 3, controls, strict=True)) + " c")
    return " ".join(path) + " f"


def _document(content: bytes, media: str) -> bytes:
    """PDF 1.4 with one page."""
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox {media} /Contents 4 0 R "
        "/Resources << /Font << /F1 5 0 R >> >> >>".encode(),
        b"<< /Length %d >>\nstream\n%s\nendstream" % (len(content), content),
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>",
        b"<< /Producer (made by fgpose board) >>",
    ]
    document, offsets = b"%PDF-1.4\n", []
    for number, each in enumerate(objects, 1):
        offsets.append(len(document))
        document += b"%d 0 obj\n%s\nendobj\n" % (number, each)
    table = b"".join(b"%010d 00000 n \n" % offset for offset in offsets)
    count = len(objects) + 1
    start = len(document)
    document += b"xref\n0 %d\n0000000000 65535 f \n%s" % (count, table)
    return document + b"trailer\n<< /Size %d /Root 1 0 R /Info 6 0 R >>\nstartxref\n%d\n%%%%EOF\n" % (count, start)
