"""Boards with a known pattern, and how they are described: charuco:7x5:30mm:22mm:DICT_5X5_100."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float

from fgpose.shown.unknown_names import nearest

BoardKind = Literal["charuco", "chessboard", "circles"]

FORMS = "charuco:7x5:30mm:22mm:DICT_5X5_100, chessboard:9x6:25mm or circles:4x11:20mm"
"""What a description looks like."""

_METRES = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254}
_LENGTH = re.compile(r"(\d+(?:\.\d+)?|\.\d+)(mm|cm|m|in)")
_SIZE = re.compile(r"(\d{1,3})[xX×](\d{1,3})")
_LEAST, _MOST = 2, 100  # points along a side
_LEAST_M, _MOST_M = 1e-3, 2.0  # of a square
_DICTIONARY = "DICT_4X4_250"
_INVERTED = "inverted"


@dataclass(frozen=True)
class Board:
    """A flat board. Its frame: x along the rows, y along the columns, downwards, z into the board; metres.

    Raises:
        ValueError: a size cannot be, or the dictionary is unknown or has too few markers.
    """

    kind: BoardKind
    size: tuple[int, int]
    """Columns and rows, as OpenCV counts: squares of charuco, inner corners of chessboard; of circles, which are
    staggered, the circles of a row and the rows."""
    square_m: float
    """Side of a square; of circles, the distance of a row from the next."""
    marker_m: float = 0.0
    """Side of a marker of charuco."""
    dictionary: str = ""
    """Of the markers of charuco, as OpenCV calls it."""
    inverted: bool = False
    """Whether it is printed white on black, as caliscope can."""

    def __post_init__(self) -> None:
        if not all(_LEAST <= side <= _MOST for side in self.size):
            raise ValueError(f"a board has {_LEAST} to {_MOST} columns and rows, got {self.size[0]} x {self.size[1]}")
        if self.n_points < 4:
            raise ValueError(
                f"{self.size[0]} x {self.size[1]} squares have {self.n_points} corners, at least 4 are needed"
            )
        if not _LEAST_M <= self.square_m <= _MOST_M:
            raise ValueError(f"a square measures 1 mm to 2 m, got {1e3 * self.square_m:g} mm")
        if self.kind == "charuco":
            if not 0 < self.marker_m < self.square_m:
                raise ValueError(
                    f"a marker is smaller than its square: {1e3 * self.marker_m:g} mm in {1e3 * self.square_m:g} mm"
                )
            _check_dictionary(self.dictionary, self.size[0] * self.size[1] // 2)

    @property
    def n_points(self) -> int:
        """Corners, or circles."""
        columns, rows = self.size
        return (columns - 1) * (rows - 1) if self.kind == "charuco" else columns * rows

    @cached_property
    def points_m(self) -> Float[np.ndarray, "point 3"]:
        """Corners or centres of circles in the frame of the board, row by row."""
        columns, rows = self.size
        if self.kind == "charuco":
            # The corner of the board is the origin.
            columns, rows = columns - 1, rows - 1
        row, column = np.divmod(np.arange(columns * rows), columns)
        x = 2 * column + row % 2 if self.kind == "circles" else column
        origin = 1.0 if self.kind == "charuco" else 0.0
        return self.square_m * np.stack([x + origin, row + origin, np.zeros(len(row))], axis=1)

    @property
    def is_ambiguous(self) -> bool:
        """Whether it looks the same after half a turn, so that two cameras may disagree about its first corner."""
        columns, rows = self.size
        return {"charuco": False, "chessboard": (columns + rows) % 2 == 0, "circles": rows % 2 == 0}[self.kind]

    def check_unambiguous(self) -> None:
        """Raise ValueError if it looks the same after half a turn."""
        if self.is_ambiguous:
            raise ValueError(
                f"{self.text} looks the same after half a turn, so that cameras may disagree about its first corner: "
                "use one with an odd and an even number of corners along its sides, or an odd number of rows of circles"
            )

    @property
    def text(self) -> str:
        """What parse_board reads."""
        parts = [self.kind, f"{self.size[0]}x{self.size[1]}", f"{1e3 * self.square_m:.6g}mm"]
        if self.kind == "charuco":
            parts += [f"{1e3 * self.marker_m:.6g}mm", self.dictionary]
        if self.inverted:
            parts.append(_INVERTED)
        return ":".join(parts)


def load_board(text: str) -> Board:
    """A board from its description, or from a file that has one (fgpose.io.calibration.board_files).

    Raises:
        ValueError: it is no description; the message names the file, or shows what one looks like.
        OSError: the file cannot be read.
    """
    from fgpose.io.calibration.board_files import board_text
    from fgpose.plain_files import naming

    path = Path(text)
    if path.suffix.lower() not in (".toml", ".yml", ".yaml", ".xml"):
        return parse_board(text)
    with naming(path):
        return parse_board(board_text(path))


def parse_board(text: str) -> Board:
    """charuco:COLUMNSxROWS:SQUARE:MARKER[:DICTIONARY], chessboard:COLUMNSxROWS:SQUARE or circles:COLUMNSxROWS:SPACING,
    lengths with mm, cm, m or in; then :inverted of one that is white on black. Raises ValueError, which
    says what is wrong with it."""
    kind, *parts = text.strip().split(":")
    inverted = parts[-1:] == [_INVERTED]
    if inverted:
        parts.pop()
    n_lengths = 2 if kind == "charuco" else 1
    if kind not in ("charuco", "chessboard", "circles"):
        meant = "".join(f" (did you mean {near}?)" for near in nearest(kind, get_args(BoardKind)))
        raise ValueError(f"a board is described as {FORMS}, or by a file (.toml, .yaml, .xml), got {text!r}{meant}")
    if not n_lengths < len(parts) <= n_lengths + 1 + (kind == "charuco"):
        raise ValueError(f"{text!r} does not have the parts of a {kind} board; boards are described as {FORMS}")
    size = _SIZE.fullmatch(parts[0])
    if size is None:
        raise ValueError(f"{text!r}: columns and rows are written as 7x5, got {parts[0]!r}")
    square_m, marker_m = [*(_length_m(part, text) for part in parts[1 : 1 + n_lengths]), 0.0][:2]
    dictionary = parts[3] if len(parts) > 3 else _DICTIONARY if kind == "charuco" else ""
    try:
        return Board(kind, (int(size[1]), int(size[2])), square_m, marker_m, dictionary, inverted)
    except ValueError as error:
        raise ValueError(f"{text!r}: {error}") from None


def _length_m(part: str, text: str) -> float:
    match = _LENGTH.fullmatch(part.strip())
    if match is None:
        raise ValueError(f"{text!r}: a length has a unit, as 30mm, 3cm, 0.03m or 1.2in, got {part!r}")
    return float(match[1]) * _METRES[match[2]]


def _check_dictionary(name: str, n_needed: int) -> None:
    import cv2

    known = [each for each in dir(cv2.aruco) if each.startswith("DICT_")]
    if name not in known:
        meant = "".join(f" (did you mean {near}?)" for near in nearest(name, known))
        raise ValueError(f"unknown dictionary {name!r}{meant}")
    n_markers = len(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name)).bytesList)
    if n_markers < n_needed:
        raise ValueError(f"{name} has {n_markers} markers, the board needs {n_needed}")
