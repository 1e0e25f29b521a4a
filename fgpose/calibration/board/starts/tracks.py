"""A board as each camera saw it over its own time, and at moments of a common clock."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from fgpose.calibration.board.board import Board
from fgpose.calibration.board.sightings import MIN_POINTS, BoardSightings
from fgpose.sampling import TIME_ROUNDING_S

# A corner whose way between two images is straight to a hundredth of a pixel, however it is accelerated by a hand.
_SLOW_PX_S = 20.0


@dataclass(frozen=True, eq=False)
class BoardTrack:
    """The board in images of one camera."""

    camera: str
    size_px: tuple[int, int]
    """Width and height."""
    time_s: Float[np.ndarray, " image"]
    """Increasing, by the camera's own clock."""
    points_px: Float[np.ndarray, "image point 2"]
    """Pixels of the original, distorted images; NaN = missing."""

    def of(self, board: Board) -> BoardSightings:
        """Its own images as moments."""
        return BoardSightings(board, (self.camera,), (self.size_px,), self.time_s, self.points_px[:, None])

    def at(
        self, time_s: Float[np.ndarray, " moment"], longest_gap_s: float
    ) -> tuple[Float[np.ndarray, "moment point 2"], Float[np.ndarray, "moment point 2"]]:
        """Points and their velocities (pixels a second) at times of its own clock, by the cubic through the two images
        before and the two after; where one of these is missing by the line between two, if the point is slow.

        Args:
            time_s: when.
            longest_gap_s: images that are further apart are not beside each other.

        Returns:
            Both NaN where images are missing, or too few points are left.
        """
        n_images, shape = len(self.time_s), (len(time_s), *self.points_px.shape[1:])
        if n_images < 2:
            return np.full(shape, np.nan), np.full(shape, np.nan)
        before = np.clip(np.searchsorted(self.time_s, time_s, side="right") - 1, 0, n_images - 2)
        around = before[:, None] + (-1, 0, 1, 2)
        images_s = self.time_s[np.clip(around, 0, n_images - 1)]
        near = np.diff(images_s) <= longest_gap_s + TIME_ROUNDING_S
        near &= (around[:, :-1] >= 0) & (around[:, 1:] < n_images)
        points_px = self.points_px[np.clip(around, 0, n_images - 1)]
        cubic = _interpolated(images_s, points_px, time_s, np.asarray(near.all(axis=1)))
        line = _interpolated(images_s[:, 1:3], points_px[:, 1:3], time_s, np.asarray(near[:, 1]))
        inside = (time_s >= images_s[:, 1] - TIME_ROUNDING_S) & (time_s <= images_s[:, 2] + TIME_ROUNDING_S)
        with np.errstate(invalid="ignore"):
            is_slow = np.linalg.norm(line[1], axis=-1, keepdims=True) < _SLOW_PX_S
        found_px, velocity = (
            np.where(np.isfinite(of_cubic), of_cubic, np.where(is_slow, of_line, np.nan))
            for of_cubic, of_line in zip(cubic, line, strict=True)
        )
        known = np.isfinite(found_px).all(axis=-1) & inside[:, None]
        known &= (known.sum(axis=1) >= MIN_POINTS)[:, None]
        return np.where(known[..., None], found_px, np.nan), np.where(known[..., None], velocity, np.nan)


def _interpolated(
    images_s: Float[np.ndarray, "moment image"],
    points_px: Float[np.ndarray, "moment image point 2"],
    time_s: Float[np.ndarray, " moment"],
    is_possible: Bool[np.ndarray, " moment"],
) -> tuple[Float[np.ndarray, "moment point 2"], Float[np.ndarray, "moment point 2"]]:
    """The polynomial through the images, and its slope, by Lagrange; NaN where that is not possible."""
    n = images_s.shape[1]
    values, slopes = np.ones_like(images_s), np.zeros_like(images_s)
    with np.errstate(divide="ignore", invalid="ignore"):
        for own in range(n):
            for other in set(range(n)) - {own}:
                apart_s = images_s[:, own] - images_s[:, other]
                # The product rule, from factor to factor.
                slopes[:, own] = (slopes[:, own] * (time_s - images_s[:, other]) + values[:, own]) / apart_s
                values[:, own] *= (time_s - images_s[:, other]) / apart_s
        both = (np.einsum("ti,tipd->tpd", weights, points_px) for weights in (values, slopes))
        at_px, velocity = (np.where(is_possible[:, None, None], each, np.nan) for each in both)
    return at_px, velocity


def sightings_at(
    tracks: Sequence[BoardTrack],
    board: Board,
    start_s: Float[np.ndarray, " camera"],
    moments_s: Float[np.ndarray, " moment"],
    longest_gaps_s: Sequence[float],
) -> BoardSightings:
    """What all cameras saw at moments of the common clock, without those at which nobody saw the board.

    Args:
        tracks: of each camera.
        board: which one.
        start_s: when their clocks began by the common one.
        moments_s: of the common clock.
        longest_gaps_s: of each camera, between two images between which corners move evenly.
    """
    each = [
        track.at(moments_s - own_s, gap_s) for track, own_s, gap_s in zip(tracks, start_s, longest_gaps_s, strict=True)
    ]
    points_px, velocity_px_s = (np.stack(arrays, axis=1) for arrays in zip(*each, strict=True))
    kept = np.isfinite(points_px).any(axis=(1, 2, 3))
    velocity_px_s = _without_noise(velocity_px_s, board)
    return BoardSightings(
        board,
        tuple(track.camera for track in tracks),
        tuple(track.size_px for track in tracks),
        moments_s[kept],
        points_px[kept],
        velocity_px_s=velocity_px_s[kept],
        start_s=np.array(start_s, dtype=float),
    )


def _without_noise(
    velocity_px_s: Float[np.ndarray, "moment camera point 2"], board: Board
) -> Float[np.ndarray, "moment camera point 2"]:
    """As an affine function of the place on the board: the velocity of a single corner has the noise of its pixels in
    it, and what is explained by both would be taken for time."""
    places = np.column_stack([np.ones(board.n_points), board.points_m[:, :2] / board.square_m])
    smooth = np.full_like(velocity_px_s, np.nan)
    for t, c in np.argwhere(np.isfinite(velocity_px_s).any(axis=(2, 3))).tolist():
        known = np.isfinite(velocity_px_s[t, c]).all(axis=1)
        fitted = np.linalg.lstsq(places[known], velocity_px_s[t, c, known], rcond=None)[0]
        smooth[t, c, known] = places[known] @ fitted
    return smooth
