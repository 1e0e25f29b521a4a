"""Which parts of the images a board covered."""

from __future__ import annotations

import numpy as np

from fgpose.calibration.board.board import Board
from fgpose.calibration.board.sightings import BoardSightings


def test_corners_are_counted_where_they_are() -> None:
    board = Board("chessboard", (3, 2), 0.1)
    points_px = np.full((2, 2, board.n_points, 2), np.nan)
    # The first pixel and the last of the first camera; the middle of the second, twice.
    points_px[0, 0, 0], points_px[1, 0, 5] = (0, 0), (799, 599)
    points_px[:, 1, 2] = (401, 301)
    sightings = BoardSightings(board, ("a", "b"), ((800, 600), (800, 600)), np.arange(2.0), points_px)
    first, second = sightings.coverage
    assert (first[0, 0], first[-1, -1], first.sum()) == (1, 1, 2)
    assert (second[3, 4], second.sum()) == (2, 2)
