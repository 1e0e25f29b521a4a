"""Whether a result and the images of its cameras are of the same time."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fgpose.sampling import TimeRange
from fgpose.trajectory import Trajectory

# Of a result: more than the last moments, which cameras that were stopped early do not have.
_NOTICED_SHARE = 0.1
# Of the step: times of both are numbers divided by the same rate, or rounded stamps.
_ROUNDING = 0.25
# Larger differences are of clocks, not of numbers: a day at 100 Hz.
_MOST_IMAGES = 100 * 86400


@dataclass(frozen=True)
class CommonTimes:
    """When a result and the images of its cameras begin and end, by the same clock."""

    result_s: tuple[float, float]
    cameras_s: tuple[tuple[float, float], ...]
    """The first image of each camera, and the last."""
    step_s: float
    """From image to image of the fastest camera."""

    @staticmethod
    def of(people: Mapping[int, Trajectory], taken_s: Sequence[np.ndarray], images_hz: float) -> CommonTimes:
        """Of a result, and of what its cameras recorded.

        Args:
            people: by number.
            taken_s: when the images of each camera, (image,), were taken, see Sources.taken_s.
            images_hz: images per second of the fastest camera.

        Raises:
            ValueError: the result has no frame.
        """
        frames_s = np.concatenate([each.time_s for each in people.values()])
        if not len(frames_s):
            raise ValueError("it has no frame")
        result_s, *cameras_s = ((float(each.min()), float(each.max())) for each in (frames_s, *taken_s))
        return CommonTimes(result_s, tuple(cameras_s), 1 / images_hz)

    @property
    def images_s(self) -> tuple[float, float]:
        """The first image of all cameras together, and the last."""
        return min(first_s for first_s, _ in self.cameras_s), max(last_s for _, last_s in self.cameras_s)

    def check(self, path: Path, wanted: TimeRange) -> None:
        """Of a result at this path, of which that time is to be shown.

        Raises:
            ValueError: no image is of its time.

        Warns:
            UserWarning: it is probably not of the time of the images, see doubt.
        """
        if nothing := self.nothing():
            raise ValueError(f"{path}: {nothing}")
        if doubt := self.doubt(wanted):
            warnings.warn(f"{path}: {doubt}", stacklevel=2)

    def nothing(self) -> str:
        """What to say where no image is of the time of the result; else empty."""
        (begin_s, end_s), (first_s, last_s) = self.result_s, self.images_s
        if begin_s <= last_s + self.step_s and end_s >= first_s - self.step_s:
            return ""
        n_later = round((begin_s - first_s) / self.step_s)
        return (
            f"the result is from {begin_s:.10g} s to {end_s:.10g} s, the images are from {first_s:.10g} s to "
            f"{last_s:.10g} s: they have no time in common. {_cause(n_later, 'about ')}"
        )

    def doubt(self, wanted: TimeRange | None = None) -> str:
        """What to say where the result is as long as a camera filmed and begins earlier or later than all, or where
        much of it is after the last image; else empty. That a result begins late or ends early says nothing, nor that a
        camera does.

        Args:
            wanted: the time of the result that matters; all by default.
        """
        n_later = self._later()
        if n_later:
            images, when = abs(n_later), "after" if n_later > 0 else "before"
            n_images = "1 image" if images == 1 else f"{images} images"
            return f"the result begins and ends {n_images} {when} those of a camera, and is as long. {_cause(n_later)}"
        (begin_s, end_s), (_, last_s) = self.result_s, self.images_s
        wanted = wanted or TimeRange()
        begin_s, end_s = max(begin_s, wanted.begin_s), min(end_s, wanted.end_s)
        share = (end_s - max(begin_s, last_s)) / (end_s - begin_s) if end_s > begin_s else 0.0
        if share <= _NOTICED_SHARE:
            return ""
        return (
            f"{100 * share:.0f} % of the result is after the last image, at {last_s:.10g} s. Are these the videos that "
            "it was made from, and the frames per second? Keypoints must be numbered as the images, those of a video "
            "from 0"
        )

    def _later(self) -> int:
        """How many images the result begins and ends later than a camera; 0 where it begins and ends with one, or with
        none as much later."""
        begins = np.array([(self.result_s[0] - first_s) / self.step_s for first_s, _ in self.cameras_s])
        ends = np.array([(self.result_s[1] - last_s) / self.step_s for _, last_s in self.cameras_s])
        n_later = np.round(begins)
        fits = (np.abs(begins - n_later) < _ROUNDING) & (np.abs(ends - n_later) < _ROUNDING)
        fits &= np.abs(n_later) <= _MOST_IMAGES
        fitting = n_later[fits]
        return int(fitting[np.abs(fitting).argmin()]) if len(fitting) else 0


def _cause(n_later: int, about: str = "") -> str:
    """Why a result begins so many images later than its cameras."""
    n_images, more = abs(n_later), "higher" if n_later > 0 else "lower"
    if n_images > _MOST_IMAGES:
        return "Their times count from different moments"
    return (
        f"The numbers of its keypoints are probably {about}{n_images} {more} than those of the images, which "
        "count from 0 in a video: number both alike, and estimate again"
    )
