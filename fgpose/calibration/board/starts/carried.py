"""Cameras that were started by hand, calibrated with a board that is carried before them: poses, lenses and starts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from fgpose.calibration.board.board import Board
from fgpose.calibration.board.calibrate import CalibratedFromBoards, calibrate_from_boards
from fgpose.calibration.board.filmed import BoardView, blurred, few_new, sharp_px, views_in
from fgpose.calibration.board.lenses import LensChoice
from fgpose.calibration.board.sightings import LeftOut
from fgpose.calibration.board.starts.lags import LONGEST_GAP_S, find_starts
from fgpose.calibration.board.starts.tracks import BoardTrack, sightings_at
from fgpose.calibration.board.world import WorldOrigin
from fgpose.geometry.camera import CameraRig
from fgpose.monocular.clips import Clip
from fgpose.sampling import spread_evenly

# Images a second in which the board is looked for first, and how many of a video at most.
_COARSE_HZ, _MOST_COARSE = 5.0, 1500
_MOST_MOMENTS = 240
# Images further apart than this many usual steps are not beside each other.
_STEPS = 1.5
# Corners are taken at the new starts until these stay.
_STAYS_S, _MOST_ROUNDS = 1e-4, 3

Progress = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class CarriedBoard:
    """What cameras on their own clocks saw of a board."""

    board: Board
    tracks: tuple[BoardTrack, ...]
    """In all images around the moments."""
    steps_s: tuple[float, ...]
    """Of each camera, from image to image."""
    start_s: Float[np.ndarray, " camera"]
    """When each began after the first, to about a hundredth of a second."""
    moments_s: Float[np.ndarray, " moment"]
    """By the clock of the first."""
    left_out: tuple[LeftOut, ...] = ()
    """Images in which the board is blurred."""


def calibrate_carried(
    carried: CarriedBoard,
    *,
    intrinsics: CameraRig | None = None,
    lens: LensChoice = "auto",
    origin: WorldOrigin | None = None,
    progress: Progress | None = None,
) -> CalibratedFromBoards:
    """As calibrate_from_boards, with the start of each camera (start_s) among the unknowns.

    Raises:
        ValueError: as calibrate_from_boards.
    """
    start_s, gaps_s = carried.start_s, [_STEPS * step_s for step_s in carried.steps_s]

    def once(start_s: Float[np.ndarray, " camera"]) -> CalibratedFromBoards:
        seen = few_new(sightings_at(carried.tracks, carried.board, start_s, carried.moments_s, gaps_s))
        seen = replace(seen, left_out=carried.left_out)
        world = origin or WorldOrigin()
        return calibrate_from_boards(seen, intrinsics=intrinsics, lens=lens, origin=world, progress=progress)

    result = once(start_s)
    for _ in range(_MOST_ROUNDS - 1):
        assert result.start_s is not None
        change_s, start_s = np.abs(result.start_s - start_s).max(), result.start_s
        if change_s < _STAYS_S:
            break
        result = once(start_s)
    return result


def carried_in(
    clips: Sequence[Clip], board: Board, intrinsics: CameraRig | None = None, *, progress: Progress | None = None
) -> CarriedBoard:
    """Look for a board in videos that began at different moments: all over them first, which tells when they began, and
    then around moments of the common clock.

    Args:
        clips: of each camera.
        board: which one.
        intrinsics: of the cameras; None: they are found.
        progress: told the number of images that were looked at, and how many there are to look at.

    Raises:
        ValueError: images have no times, a video is too long, no image of a camera shows the board, or an image cannot
            be read; the message names the camera or the file.
        NotLinkedError: the motion that a camera sees agrees with that of no other.
    """
    for clip in clips:
        if clip.files and clip.given_fps == 1.0:
            raise ValueError(
                f"camera {clip.name}: images have no times, from which starts could be found: say how many there are "
                "a second with --fps, or take videos"
            )
    times_s = [clip.taken_s() for clip in clips]
    coarse = [_coarse(clip, own_s) for clip, own_s in zip(clips, times_s, strict=True)]
    looked = _Looked(clips, board, times_s, progress)
    looked.at(coarse)
    never = [clip.name for clip, views in zip(clips, looked.views, strict=True) if not any(views.values())]
    if never:
        raise ValueError(
            f"camera {', '.join(never)}: no image shows {board.text}; check its columns and rows, and its dictionary"
        )
    start_s = find_starts(looked.tracks(), board, intrinsics)
    moments_s = looked.moments_s(start_s)
    looked.at([_around(own_s, moments_s - begin_s) for own_s, begin_s in zip(times_s, start_s, strict=True)])
    steps_s = tuple(float(np.median(np.diff(own_s))) for own_s in times_s)
    left_out = looked.blurred(moments_s, start_s)
    return CarriedBoard(board, looked.tracks(), steps_s, start_s, moments_s, left_out)


class _Looked:
    """The images of each camera that were looked at, and what was found."""

    def __init__(
        self,
        clips: Sequence[Clip],
        board: Board,
        times_s: Sequence[Float[np.ndarray, " _"]],
        progress: Progress | None,
    ) -> None:
        self._clips, self._board, self._times_s, self._progress = clips, board, times_s, progress
        self._n_done = 0
        self.views = [dict[int, BoardView | None]() for _ in clips]
        """By the number of the image."""

    def at(self, numbers: Sequence[Int[np.ndarray, " _"]]) -> None:
        """Look at these images of each camera."""
        wanted = [
            np.array([number for number in own.tolist() if number not in known], dtype=int)
            for own, known in zip(numbers, self.views, strict=True)
        ]
        n_images = self._n_done + sum(map(len, wanted))

        def seen(_: object) -> None:
            self._n_done += 1
            if self._progress:
                self._progress(self._n_done, n_images)

        # OpenCV works without the interpreter's lock.
        with ThreadPoolExecutor() as pool:
            jobs = [
                pool.submit(views_in, clip, own, self._board, seen)
                for clip, own in zip(self._clips, wanted, strict=True)
            ]
            for known, own, job in zip(self.views, wanted, jobs, strict=True):
                known |= dict(zip(own.tolist(), job.result(), strict=True))

    def tracks(self) -> tuple[BoardTrack, ...]:
        """With the sharp views."""
        tracks = []
        for clip, times_s, views, limit_px in zip(
            self._clips, self._times_s, self.views, self._limits_px(), strict=True
        ):
            numbers = sorted(views)
            points_px = np.full((len(numbers), self._board.n_points, 2), np.nan)
            for row, number in enumerate(numbers):
                view = views[number]
                if view is not None and view.blur_px <= limit_px:
                    points_px[row] = view.points_px
            tracks.append(BoardTrack(clip.name, clip.size_px, times_s[numbers], points_px))
        return tuple(tracks)

    def moments_s(self, start_s: Float[np.ndarray, " camera"]) -> Float[np.ndarray, " moment"]:
        """Of the common clock, evenly spread over those at which a camera sees the board."""
        seen_s = np.sort(np.concatenate([
            track.time_s[np.isfinite(track.points_px).any(axis=(1, 2))] + own_s
            for track, own_s in zip(self.tracks(), start_s, strict=True)
        ]))  # fmt: skip
        seen_s = seen_s[np.append(True, np.diff(seen_s) > 0.5 / _COARSE_HZ)]
        return seen_s[spread_evenly(len(seen_s), _MOST_MOMENTS)]

    def blurred(
        self, moments_s: Float[np.ndarray, " moment"], start_s: Float[np.ndarray, " camera"]
    ) -> tuple[LeftOut, ...]:
        """The views before the moments that are not sharp."""
        found = []
        each = zip(self._clips, self._times_s, self.views, self._limits_px(), start_s.tolist(), strict=True)
        for clip, times_s, views, limit_px, own_s in each:
            before = np.searchsorted(times_s, moments_s - own_s, side="right") - 1
            for moment_s, number in zip(moments_s.tolist(), before.tolist(), strict=True):
                view = views.get(number)
                if view is not None and view.blur_px > limit_px:
                    found.append(LeftOut(clip.name, moment_s, blurred(view, limit_px)))
        return tuple(found)

    def _limits_px(self) -> list[float]:
        return [sharp_px([view for view in views.values() if view is not None]) for views in self.views]


def _coarse(clip: Clip, times_s: Float[np.ndarray, " image"]) -> Int[np.ndarray, " chosen"]:
    """Numbers of images all over a video."""
    if len(times_s) < 2:
        raise ValueError(f"camera {clip.name}: a single image has no motion, from which its start could be found")
    duration_s = float(times_s[-1] - times_s[0])
    longest_s = LONGEST_GAP_S * _MOST_COARSE
    if duration_s > longest_s:
        raise ValueError(
            f"camera {clip.name}: its video lasts {duration_s / 60:.0f} minutes, starts are found in "
            f"{longest_s / 60:.0f} at most: cut it, or use its first images (--frames)"
        )
    n = min(round(duration_s * _COARSE_HZ) + 1, _MOST_COARSE)
    return spread_evenly(len(times_s), n)


def _around(times_s: Float[np.ndarray, " image"], moments_s: Float[np.ndarray, " moment"]) -> Int[np.ndarray, " image"]:
    """Numbers of the two images before each moment and the two after it."""
    before = np.searchsorted(times_s, moments_s, side="right") - 1
    inside = (before >= 0) & (before < len(times_s) - 1)
    numbers = np.unique(before[inside, None] + (-1, 0, 1, 2))
    return numbers[(numbers >= 0) & (numbers < len(times_s))]
