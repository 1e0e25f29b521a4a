"""What the cameras saw of a board."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.calibration.board.board import Board
from fgpose.shown import Shown

MIN_POINTS = 6
"""Of a board in a view: fewer say little of its pose."""
COVERED_ROWS, COVERED_COLUMNS = 6, 8
"""Parts of an image that are covered by a board or not: of 80 px in one of 640."""


@dataclass(frozen=True)
class LeftOut:
    """A view of the board that is not used."""

    camera: str
    time_s: float
    reason: str


@dataclass(frozen=True, eq=False, repr=False)
class BoardSightings(Shown):
    """Corners of one board, seen by several cameras at the same moments."""

    board: Board
    camera_names: tuple[str, ...]
    sizes_px: tuple[tuple[int, int], ...]
    """Width and height of the images of each camera."""
    time_s: Float[np.ndarray, " moment"]
    """Increasing, by the common clock."""
    points_px: Float[np.ndarray, "moment camera point 2"]
    """Pixels of the original, distorted images; NaN = missing."""
    left_out: tuple[LeftOut, ...] = ()
    velocity_px_s: Float[np.ndarray, "moment camera point 2"] | None = None
    """Of the points, where cameras began at different moments: an error of start_s moves them. None: it does not."""
    start_s: Float[np.ndarray, " camera"] | None = None
    """When each camera began, by the common clock, as it was taken for time_s; None: they have one clock."""
    is_numbered: bool = False
    """Whether times are the numbers of images, of folders that say no times."""
    n_without: tuple[int, ...] = ()
    """Images of each camera that were looked at and do not show the board; empty: not counted."""

    @property
    def seen(self) -> Bool[np.ndarray, "moment camera point"]:
        return np.asarray(np.isfinite(self.points_px).all(axis=-1))

    @property
    def shows_board(self) -> Bool[np.ndarray, "moment camera"]:
        return np.asarray(self.seen.any(axis=-1))

    def when(self, time_s: float) -> str:
        """A moment in words: which image, where images have no times."""
        return f"in image {time_s:.0f}" if self.is_numbered else f"at {time_s:.2f} s"

    def at_moments(self, moments: Int[np.ndarray, " chosen"] | Bool[np.ndarray, " moment"]) -> BoardSightings:
        """At some of the moments."""
        velocity_px_s = None if self.velocity_px_s is None else self.velocity_px_s[moments]
        return replace(
            self, time_s=self.time_s[moments], points_px=self.points_px[moments], velocity_px_s=velocity_px_s
        )

    @property
    def coverage(self) -> Int[np.ndarray, "camera row column"]:
        """How many corners each camera saw in each part of its image, from the top left."""
        sizes_px = np.array(self.sizes_px, dtype=float)
        # The middle of the first pixel is at 0.
        share = (self.points_px + 0.5) / sizes_px[:, None]
        _, camera, _ = np.nonzero(self.seen)
        column, row = (share[self.seen] * (COVERED_COLUMNS, COVERED_ROWS)).astype(int).T
        counts = np.zeros((len(sizes_px), COVERED_ROWS, COVERED_COLUMNS), dtype=int)
        np.add.at(counts, (camera, row.clip(0, COVERED_ROWS - 1), column.clip(0, COVERED_COLUMNS - 1)), 1)
        return counts

    def of_camera(self, c: int) -> BoardSightings:
        """Of one camera, at the moments at which it sees the board."""
        sees = self.shows_board[:, c]
        return replace(
            self,
            camera_names=self.camera_names[c : c + 1],
            sizes_px=self.sizes_px[c : c + 1],
            time_s=self.time_s[sees],
            points_px=self.points_px[sees, c : c + 1],
            velocity_px_s=None if self.velocity_px_s is None else self.velocity_px_s[sees, c : c + 1],
            start_s=None if self.start_s is None else self.start_s[c : c + 1],
            n_without=self.n_without[c : c + 1],
        )

    def without(self, views: Bool[np.ndarray, "moment camera"], reasons: Sequence[LeftOut]) -> BoardSightings:
        """Without some views, and without moments at which then nobody sees the board."""
        points_px = np.where(views[..., None, None], np.nan, self.points_px)
        kept = np.asarray(np.isfinite(points_px).any(axis=(1, 2, 3)))
        return replace(self, points_px=points_px, left_out=(*self.left_out, *reasons)).at_moments(kept)
