"""A board in videos or folders of images: which moments are looked at, and which views are used."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from fgpose.calibration.board.board import Board
from fgpose.calibration.board.detection import Detector, blur_px, detector_of
from fgpose.calibration.board.sightings import BoardSightings, LeftOut
from fgpose.monocular.clips import Clip
from fgpose.monocular.network import Image
from fgpose.monocular.sources import find_clips
from fgpose.sampling import TIME_ROUNDING_S, nearest, spread_evenly, usual_step_s
from fgpose_factors.robust_statistics import known_median

_FPS_OF_IMAGES = 1.0  # images of a board have numbers, and no times
_MOST_MOMENTS = 240  # of a recording that are looked at, evenly spread
_MOST_USED = 120  # with the board in them; more would say the same again
# Of edges of the sharpest quarter of the views of a camera, and pixels.
_BLURRED, _BLURRED_PX = 1.8, 2.5
_STILL = 0.005  # of the diagonal of the image: a board that has moved by less is the same view again


@dataclass(frozen=True, eq=False)
class BoardView:
    """The board in one image."""

    points_px: Float[np.ndarray, "point 2"]
    blur_px: float


def find_boards(
    path: str | Path,
    board: Board,
    *,
    fps: float | None = None,
    cameras: tuple[str, ...] = (),
    progress: Callable[[int, int], None] | None = None,
) -> BoardSightings:
    """What synchronised cameras saw of a board.

    Args:
        path: a folder with one video per camera (cam01.mp4), or one folder of images for each; images of the same
            number are of the same moment.
        board: which one.
        fps: images per second, where it is not as the videos say.
        cameras: use only these, in this order.
        progress: as of boards_in.

    Raises:
        ValueError: as boards_in; there are no videos, or one is damaged.
        OSError: a file cannot be opened.
    """
    return boards_in(board_clips(path, fps, cameras), board, progress=progress)


def board_clips(path: str | Path, fps: float | None = None, cameras: tuple[str, ...] = ()) -> tuple[Clip, ...]:
    """The videos or images, see find_boards."""
    return find_clips(path, fps=fps, cameras=cameras, fps_of_images=_FPS_OF_IMAGES)


def boards_in(
    clips: Sequence[Clip], board: Board, *, progress: Callable[[int, int], None] | None = None
) -> BoardSightings:
    """Look for a board at moments that are evenly spread, and use sharp views of it in different places.

    Args:
        clips: of each camera, on one clock: images are of one moment if their times are, to half an image.
        board: which one.
        progress: told the number of images that were looked at, and how many there are to look at.

    Raises:
        ValueError: no image shows the board, or an image cannot be read; the message names the camera or the file.
    """
    times_s = [clip.taken_s() for clip in clips]
    moments_s, images = _moments(times_s)
    n_images, n_done = int((images >= 0).sum()), 0

    def seen(_: object) -> None:
        nonlocal n_done
        n_done += 1
        if progress:
            progress(n_done, n_images)

    # OpenCV works without the interpreter's lock.
    with ThreadPoolExecutor() as pool:
        jobs = [pool.submit(views_in, clip, images[:, c], board, seen) for c, clip in enumerate(clips)]
        views = [job.result() for job in jobs]
    never = [clip.name for clip, own in zip(clips, views, strict=True) if not any(own)]
    if never:
        raise ValueError(
            f"camera {', '.join(never)}: no image shows {board.text}; check its columns and rows, and its dictionary"
        )
    n_without = tuple(own.count(None) - int((images[:, c] < 0).sum()) for c, own in enumerate(views))
    return replace(_used(clips, board, moments_s, views), n_without=n_without)


def _moments(times_s: Sequence[Float[np.ndarray, " image"]]) -> tuple[np.ndarray, Int[np.ndarray, "moment camera"]]:
    """Times, and the number of the image of each camera then, -1 where there is none."""
    reference = max(times_s, key=len)
    step_s = usual_step_s(reference) if len(reference) > 1 else 1.0
    # All times, so that a moment that one camera has not is one of the others.
    every_s = np.sort(np.concatenate(times_s))
    every_s = every_s[np.append(True, np.diff(every_s) > step_s / 2)]
    moments_s = every_s[spread_evenly(len(every_s), _MOST_MOMENTS)]
    images = np.full((len(moments_s), len(times_s)), -1)
    for c, own_s in enumerate(times_s):
        number = nearest(moments_s, own_s)
        is_then = np.abs(own_s[number] - moments_s) <= step_s / 2 + TIME_ROUNDING_S
        images[is_then, c] = number[is_then]
    return moments_s, images


def views_in(
    clip: Clip, numbers: Int[np.ndarray, " moment"], board: Board, seen: Callable[[object], None]
) -> list[BoardView | None]:
    """What one camera saw in these images, -1: none, of which each is looked at once; seen is called for each.

    Raises:
        ValueError: an image cannot be read, or has another size; the message names it.
    """
    detector = detector_of(board)
    wanted = [number for number in dict.fromkeys(numbers.tolist()) if number >= 0]
    found: dict[int, BoardView | None] = {}
    for number, image in clip.images_one_by_one(wanted):
        if image.shape[:2] != clip.size_px[::-1]:
            raise ValueError(f"{clip.path}, image {number}: its size is not that of the first image")
        found[number] = _view(detector, image)
        seen(None)
    return [found.get(number) for number in numbers.tolist()]


def _view(detector: Detector, image: Image) -> BoardView | None:
    import cv2

    grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
    points_px = detector.find(grey)
    return None if points_px is None else BoardView(points_px, blur_px(grey, points_px))


def _used(
    clips: Sequence[Clip],
    board: Board,
    moments_s: Float[np.ndarray, " moment"],
    views: Sequence[Sequence[BoardView | None]],
) -> BoardSightings:
    """The sharp views, at moments that show something new."""
    points_px = np.full((len(moments_s), len(clips), board.n_points, 2), np.nan)
    reasons = list[LeftOut]()
    for c, (clip, own) in enumerate(zip(clips, views, strict=True)):
        limit_px = sharp_px([view for view in own if view is not None])
        for t, view in enumerate(own):
            if view is None:
                continue
            if view.blur_px <= limit_px:
                points_px[t, c] = view.points_px
            else:
                reasons.append(LeftOut(clip.name, float(moments_s[t]), blurred(view, limit_px)))
    sizes_px = tuple(clip.size_px for clip in clips)
    names = tuple(clip.name for clip in clips)
    is_numbered = all(clip.files and clip.fps == _FPS_OF_IMAGES for clip in clips)
    return few_new(
        BoardSightings(board, names, sizes_px, moments_s, points_px, tuple(reasons), is_numbered=is_numbered)
    )


def few_new(sightings: BoardSightings) -> BoardSightings:
    """At 120 moments at most, evenly spread over those that show something new."""
    new = _new(sightings.points_px, np.array([np.hypot(*size) for size in sightings.sizes_px]))
    return sightings.at_moments(new[spread_evenly(len(new), _MOST_USED)])


def blurred(view: BoardView, limit_px: float) -> str:
    """Why a view is not used."""
    return f"it is blurred: edges of {view.blur_px:.1f} px, {limit_px:.1f} are allowed"


def sharp_px(views: Sequence[BoardView]) -> float:
    """Of a camera the widest edges that are sharp."""
    return max(_BLURRED * float(np.quantile([view.blur_px for view in views], 0.25)), _BLURRED_PX)


def _new(
    points_px: Float[np.ndarray, "moment camera point 2"], diagonal_px: Float[np.ndarray, " camera"]
) -> Int[np.ndarray, " used"]:
    """Moments with the board, without those at which no camera sees that it has moved since the last of them: errors
    of one pose seen again are the same again."""
    used = list[int]()
    for t in np.flatnonzero(np.isfinite(points_px).any(axis=(1, 2, 3))).tolist():
        if used:
            apart_px = np.linalg.norm(points_px[t] - points_px[used[-1]], axis=-1)
            known, before = (np.asarray(np.isfinite(points_px[at]).any(axis=(1, 2))) for at in (t, used[-1]))
            moved = np.array([known_median(own) for own in apart_px]) > _STILL * diagonal_px
            if not (moved | (known & ~before)).any():
                continue
        used.append(t)
    return np.array(used, dtype=int)
