"""Images that were put in the order of their names as text: 1, 10, 11, ..., 2, 20."""

from __future__ import annotations

import warnings

import numpy as np
from jaxtyping import Float, Int

from fgpose.diagnosis.examined import Examined
from fgpose.finding import Code, Finding, Severity
from fgpose.sampling import parts_of

_FIRST_NUMBERS = 0, 1
_FEWEST = 3  # places at which the order changes
# In the right order the next image shows nearly the same; those that text puts side by side are ten or more apart.
_FARTHER = 3.0


def sorted_as_text(examined: Examined) -> list[Finding]:
    """Names without leading zeros, sorted as text: somebody jumps to and fro, and moves steadily if they are sorted by
    number."""
    seen = examined.main
    farther = np.array([_times_farther(seen.points2d_px[:, c]) for c in range(seen.n_cameras)])
    found = np.flatnonzero(farther > _FARTHER)
    if not len(found):
        return []
    cameras = [seen.camera_names[c] for c in found]
    where = examined.in_words(cameras)
    return [
        Finding(
            Code.FRAME_ORDER,
            Severity.WRONG,
            f"The images of {where} were sorted by their names as text (1, 10, 11, ..., 2, 20): where that leaves the "
            f"order of numbers, joints jump {np.median(farther[found]):.0f} times as far as they move in that order",
            "Put the images in the order of their numbers, before the keypoints of all are put together.",
            1.0,
            camera=cameras[0] if len(cameras) == 1 else "",
        )
    ]


def _times_farther(points_px: Float[np.ndarray, "frame joint 2"]) -> float:
    """Than in the order of numbers, at the places where that differs; 0: there is too little to tell."""
    return max(_ratio(points_px, places_by_number(len(points_px), first)) for first in _FIRST_NUMBERS)


def places_by_number(n_images: int, first: int) -> Int[np.ndarray, " image"]:
    """Of images that are numbered from the first on and were sorted as text: where the next one by number stands."""
    numbers = np.array(sorted(range(first, first + n_images), key=str))
    return np.argsort(numbers)


def _ratio(points_px: Float[np.ndarray, "frame joint 2"], by_number: Int[np.ndarray, " frame"]) -> float:
    given_px, by_number_px = (_steps_px(points_px, order) for order in (np.arange(len(points_px)), by_number))
    follows = np.zeros(len(given_px), dtype=bool)  # the next by number stands next
    adjacent = np.diff(by_number) == 1
    follows[by_number[:-1][adjacent]] = True
    given_px, by_number_px = (each[np.isfinite(each)] for each in (given_px[~follows], by_number_px[~adjacent]))
    # Of an image that stands still, joints move by nothing.
    if min(len(given_px), len(by_number_px)) < _FEWEST or not np.median(by_number_px) > 0:
        return 0.0
    return float(np.median(given_px) / np.median(by_number_px))


def _steps_px(
    points_px: Float[np.ndarray, "frame joint 2"], order: Int[np.ndarray, " frame"]
) -> Float[np.ndarray, " step"]:
    """How far the joints move from image to image in this order, their median; NaN where none is in both."""
    steps_px = np.empty(max(len(order) - 1, 0), dtype=points_px.dtype)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # no joint
        for part in parts_of(len(steps_px)):
            moved_px = np.diff(points_px[order[part.start : part.stop + 1]], axis=0)
            steps_px[part] = np.nanmedian(np.linalg.norm(moved_px, axis=-1), axis=-1)
    return steps_px
