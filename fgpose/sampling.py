"""How a recording is sampled in time: its usual step and rate, frames spread over it, and what is between images."""

from __future__ import annotations

import warnings
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import median
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose_factors.robust_statistics import medians

TIME_ROUNDING_S = 1e-6
"""Times that differ by less are the same."""
# A dropped image is a gap of two steps, the jitter of a webcam's clock a few tenths of one.
_LONGEST_STEPS = 1.5


# Times of cameras are 1/1000 to 1 s apart; time lapses tell no motion.
_SHORTEST_STEP_S, _LONGEST_STEP_S = 5e-4, 2.0
_UNITS_S = {"milliseconds, or numbers of frames": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9}
_FEW_STEPS = 10
# The median of these is the usual step. With more, a change of the frame rate is noticed later; with fewer, jitter
# disturbs it.
_REMEMBERED_STEPS = 50
# Cameras that are started by hand are so within minutes.
_APART_S = 600.0


def is_of_a_camera(step_s: float) -> bool:
    """Whether cameras take images that are so far apart, seconds."""
    return bool(_SHORTEST_STEP_S < step_s < _LONGEST_STEP_S)  # also of numbers of numpy


def other_unit(step_s: float) -> str:
    """What times are probably in whose step is not that of a camera if they are taken for seconds."""
    units = (unit for unit, seconds in _UNITS_S.items() if is_of_a_camera(step_s * seconds))
    return next(units, "another unit")


class Pace:
    """How fast the images of cameras follow each other.

    Args:
        warns: once where their times are not in seconds.
    """

    def __init__(self, *, warns: bool = True) -> None:
        self._last_s: deque[float] = deque(maxlen=_REMEMBERED_STEPS)
        self._odd_s: list[float] | None = [] if warns else None  # None: it is not told again

    @property
    def usual_step_s(self) -> float:
        """Usual time from one image of a camera to its next; 0 until a camera has given two."""
        return float(median(self._last_s)) if self._last_s else 0.0

    def add(self, step_s: float) -> None:
        """Take the time from one image of a camera to its next.

        Warns:
            UserWarning: the last ten are longer or shorter than those of any camera, and the usual one is too: images
                that were held up may come in a burst.
        """
        self._last_s.append(step_s)
        if self._odd_s is None:
            return
        self._odd_s = [] if is_of_a_camera(step_s) else [*self._odd_s, step_s]
        if len(self._odd_s) >= _FEW_STEPS and not is_of_a_camera(self.usual_step_s):
            usual_s, self._odd_s = float(np.median(self._odd_s)), None
            warnings.warn(
                f"the images of a camera follow each other by {usual_s:.3g} s: no camera films like that. Times are in "
                f"seconds: are these in {other_unit(usual_s)}?",
                UserWarning,
                stacklevel=2,
            )


def usual_step_s(time_s: Float[np.ndarray, " frame"]) -> float:
    """Median time from frame to frame, seconds; inf with one frame."""
    return float(medians(np.diff(time_s))) if len(time_s) > 1 else np.inf


def frames_per_second(time_s: Float[np.ndarray, " frame"]) -> float:
    """One over the mean of the steps that are about the usual one: those of gaps are not; NaN with one frame.

    The median alone would be off where times are rounded: those of 60 Hz to 17 ms are 58.8 Hz.
    """
    if len(time_s) < 2:
        return np.nan
    steps_s, usual_s = np.diff(time_s), usual_step_s(time_s)
    of_one_frame = np.abs(steps_s - usual_s) <= (_LONGEST_STEPS - 1) * usual_s
    return float(1 / np.mean(steps_s[of_one_frame])) if of_one_frame.any() else 1 / usual_s


def are_gaps(time_s: Float[np.ndarray, " frame"]) -> Bool[np.ndarray, " step"]:
    """Which of the steps from frame to frame are longer than one frame: others are missing there."""
    return np.diff(time_s) > _LONGEST_STEPS * usual_step_s(time_s)


def forward(frames: Any) -> Any:
    """The same frames, as an array is indexed by them. Raises ValueError for a slice that goes back in time."""
    if isinstance(frames, slice) and frames.step is not None and frames.step < 0:
        raise ValueError(f"frames are taken forward in time: a step of {frames.step} would turn the recording round")
    return frames


def one_after_another(times_s: Sequence[Float[np.ndarray, " _frames"]]) -> Float[np.ndarray, " frame"]:
    """The times of parts of a recording as those of the whole. Raises ValueError unless they increase."""
    time_s = np.concatenate(times_s)
    if (backward := np.flatnonzero(np.diff(time_s) <= 0)).size:
        at = backward[0]
        raise ValueError(f"time must increase: a frame at {time_s[at + 1]:.6g} s follows one at {time_s[at]:.6g} s")
    return time_s


def numbers_of_all(parts: Sequence[Int[np.ndarray, " _frames"] | None]) -> Int[np.ndarray, " frame"] | None:
    """The numbers of their frames; None where a part has none, or they do not go on."""
    known = [numbers for numbers in parts if numbers is not None]
    numbers = np.concatenate(known) if len(known) == len(parts) else np.zeros(2, dtype=int)
    return numbers if (np.diff(numbers) > 0).all() else None


@dataclass(frozen=True)
class TimeRange:
    """From one time to another, both included.

    Raises:
        ValueError: it ends before it begins.
    """

    begin_s: float = -np.inf
    end_s: float = np.inf

    def __post_init__(self) -> None:
        if not self.begin_s <= self.end_s:
            raise ValueError(f"there is nothing {self}")

    def __str__(self) -> str:
        begin = f"from {self.begin_s:.10g} s " if self.begin_s > -np.inf else ""
        return f"{begin}to {self.end_s:.10g} s" if self.end_s < np.inf else f"{begin}on"

    def contains(self, time_s: Float[np.ndarray, " frame"]) -> Bool[np.ndarray, " frame"]:
        """Which of these times are in it."""
        return (time_s >= self.begin_s - TIME_ROUNDING_S) & (time_s <= self.end_s + TIME_ROUNDING_S)

    def of(self, time_s: Float[np.ndarray, " frame"]) -> Bool[np.ndarray, " frame"]:
        """The same of times that increase. Raises ValueError if none is, with those that there are."""
        inside = self.contains(time_s)
        if not inside.any():
            there = f"from {time_s[0]:.10g} s to {time_s[-1]:.10g} s" if len(time_s) else "at no time"
            raise ValueError(f"no frame is {self}: there are frames {there}")
        return inside


def thinning(time_s: Float[np.ndarray, " frame"], fps: float | None, at_most: int) -> int:
    """Of how many frames one is taken, at least 1, so that about so many a second are.

    Args:
        time_s: of all frames.
        fps: frames per second; None: all, but of a long recording at most so many.
        at_most: frames, where no rate is given.
    """
    if fps is None:
        return max(1, -(-len(time_s) // at_most))
    usual_fps = frames_per_second(time_s)
    return max(1, round(usual_fps / fps)) if np.isfinite(usual_fps) else 1


def nearest(times_s: Float[np.ndarray, " time"], others_s: Float[np.ndarray, " other"]) -> Int[np.ndarray, " time"]:
    """Index of the nearest of the others, at least one, which increase, for each time; of two the earlier."""
    after = np.clip(np.searchsorted(others_s, times_s), 1, max(len(others_s) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(others_s) - 1)
    return np.where(np.abs(others_s[after] - times_s) < np.abs(others_s[before] - times_s), after, before)


def spread_evenly(n_frames: int, at_most: int) -> Int[np.ndarray, " sample"]:
    """Frames spread evenly over a long recording; all of a short one."""
    return np.unique(np.linspace(0, n_frames - 1, min(n_frames, at_most)).round().astype(int))


def parts_of(n_frames: int, at_once: int = 1000) -> list[slice]:
    """Consecutive frames, so many at once, so that the memory of what is made of them is bounded."""
    return [slice(start, min(start + at_once, n_frames)) for start in range(0, n_frames, at_once)]


def stretches(chosen: Bool[np.ndarray, " frame"]) -> list[tuple[int, int]]:
    """First and one past the last of each run of frames that are chosen."""
    edges = np.flatnonzero(np.diff(chosen.astype(int), prepend=0, append=0)).reshape(-1, 2)
    return [(first, end) for first, end in edges.tolist()]


def fair_limits(wanted: Sequence[int] | Sequence[float], total: int | float) -> list[float]:
    """How much of a total each may have at most: all the same, and what some do not want goes to the others."""
    limits = [0.0] * len(wanted)
    for n_served, who in enumerate(sorted(range(len(wanted)), key=lambda each: wanted[each])):
        limits[who] = total / (len(wanted) - n_served)
        total -= min(wanted[who], limits[who])
    return limits


def mean_times_s(time_s: Float[np.ndarray, "frame camera"]) -> Float[np.ndarray, " frame"]:
    """One time per frame: the mean of what is known, of equal times exactly that; NaN where nothing is."""
    known = np.isfinite(time_s)
    counts = known.sum(axis=1)
    first_s = np.where(known, time_s, np.inf).min(axis=1, initial=np.inf)
    later_s = np.where(known, time_s - first_s[:, None], 0.0).sum(axis=1)
    return np.where(counts > 0, first_s + later_s / np.maximum(counts, 1), np.nan)


def checked_times_s(time_s: Any, n_frames: int, camera_names: Sequence[str]) -> np.ndarray:
    """A copy of the times of frames, (T,), or of all cameras' images, (T, C), NaN where there is none.

    Raises:
        ValueError: the shape is another, a frame has no time, times do not increase, those of a camera's images
            neither, or the clock of a camera is not that of the others.
    """
    time_s = np.array(time_s, dtype=float)
    if time_s.shape not in ((n_frames,), (n_frames, len(camera_names))):
        raise ValueError(f"time_s must be ({n_frames},) or ({n_frames}, {len(camera_names)}), got {time_s.shape}")
    frame_time_s = time_s if time_s.ndim == 1 else mean_times_s(time_s)
    infinite = np.isinf(time_s).reshape(n_frames, -1).any(axis=1)
    bad = np.flatnonzero(infinite | np.isnan(frame_time_s))
    if bad.size:
        raise ValueError(f"time_s is not finite at frame {bad[0]}")
    if time_s.ndim == 2:
        _check_clocks(time_s, frame_time_s, camera_names)
    backward = np.flatnonzero(np.diff(frame_time_s) <= 0)
    if backward.size:
        frame = backward[0] + 1
        raise ValueError(
            f"time_s must increase: frame {frame} is at {frame_time_s[frame]:.13g} s, "
            f"the one before at {frame_time_s[frame - 1]:.13g} s"
        )
    return time_s


def _check_clocks(
    time_s: Float[np.ndarray, "frame camera"], frame_time_s: Float[np.ndarray, " frame"], camera_names: Sequence[str]
) -> None:
    """Raises ValueError where a camera's clock is not that of the others, stands still or goes back."""
    away_s = np.abs(np.nan_to_num(time_s - frame_time_s[:, None]))
    if away_s.max(initial=0.0) > _APART_S:
        frame, camera = np.argwhere(away_s == away_s.max())[0].tolist()
        raise ValueError(
            f"time_s of camera {camera_names[camera]} is {time_s[frame, camera]:.13g} s at frame {frame}, far "
            "from those of the others: all times must count from one moment"
        )
    for camera, name in enumerate(camera_names if len(time_s) > 1 else ()):
        frames = np.flatnonzero(np.isfinite(time_s[:, camera]))
        own_s = time_s[frames, camera]
        backward = np.flatnonzero(np.diff(own_s) <= 0)
        if backward.size:
            at = backward[0] + 1
            raise ValueError(
                f"time_s of camera {name} must increase: frame {frames[at]} is at {own_s[at]:.13g} s, its image "
                f"before at {own_s[at - 1]:.13g} s; if its clock is coarse or steps, give one time for each frame"
            )


def between_images(
    time_s: Float[np.ndarray, " image"], values: Float[np.ndarray, "image ..."], at_s: Float[np.ndarray, " sample"]
) -> Float[np.ndarray, "sample ..."]:
    """Linear between the two images around each time; NaN before the first, after the last and in a gap.

    At 25 Hz a joint that is accelerated by 20 m/s^2, as the ankle of a walker, is put 4 mm beside its way at most.
    """
    if len(time_s) < 2:
        return np.full((len(at_s), *values.shape[1:]), np.nan)
    return Around.of(time_s, at_s).between(values)


def at_times(
    time_s: Float[np.ndarray, " frame"], values: Float[np.ndarray, "frame ..."], at_s: Float[np.ndarray, " sample"]
) -> Float[np.ndarray, "sample ..."]:
    """As between_images, also of one frame; exactly that of a frame where the times are the same."""
    close = nearest(at_s, time_s)
    same = np.abs(time_s[close] - at_s) <= TIME_ROUNDING_S
    found = between_images(time_s, values, at_s)
    found[same] = values[close[same]]
    return found


def smaller_around(
    time_s: Float[np.ndarray, " image"], values: Float[np.ndarray, "image ..."], at_s: Float[np.ndarray, " sample"]
) -> Float[np.ndarray, "sample ..."]:
    """The smaller of the values of the two images around each time; 0 where there are not two, or a gap."""
    if len(time_s) < 2:
        return np.zeros((len(at_s), *values.shape[1:]))
    return Around.of(time_s, at_s).smaller(values)


@dataclass(frozen=True, eq=False)
class Around:
    """The two images around each of some times."""

    before: Int[np.ndarray, " sample"]
    """The first of them."""
    share: Float[np.ndarray, " sample"]
    """Of the way to the second."""
    is_there: Bool[np.ndarray, " sample"]
    """Whether both are near."""

    @staticmethod
    def of(time_s: Float[np.ndarray, " image"], at_s: Float[np.ndarray, " sample"]) -> Around:
        """Of two images at least."""
        before = np.clip(np.searchsorted(time_s, at_s, side="right") - 1, 0, len(time_s) - 2)
        step_s = time_s[before + 1] - time_s[before]
        share = (at_s - time_s[before]) / np.where(step_s > 0, step_s, np.nan)
        # Sums of times are rounded: what is an image within a nanosecond is that image.
        share = np.where(np.abs(share - np.round(share)) < 1e-7, np.round(share), share)
        is_image = (share == 0) | (share == 1)
        inside = (share >= 0) & (share <= 1) & (is_image | (step_s <= _LONGEST_STEPS * usual_step_s(time_s)))
        return Around(before, np.clip(share, 0, 1), inside)

    def counted_from(self, image: int) -> Around:
        """The same of the images from one on."""
        return replace(self, before=self.before - image)

    def between(self, values: Float[np.ndarray, "image ..."]) -> Float[np.ndarray, "sample ..."]:
        """See between_images."""
        share = self.share.reshape(-1, *(1,) * (values.ndim - 1))
        # Where the time is that of an image, the other one does not matter, and may be missing.
        first, second = (1 - share) * values[self.before], share * values[self.before + 1]
        between = np.where(
            share == 0, values[self.before], np.where(share == 1, values[self.before + 1], first + second)
        )
        between[~self.is_there] = np.nan
        return between

    def smaller(self, values: Float[np.ndarray, "image ..."]) -> Float[np.ndarray, "sample ..."]:
        """See smaller_around."""
        share = self.share.reshape(-1, *(1,) * (values.ndim - 1))
        first, second = values[self.before], values[self.before + 1]
        smaller = np.where(share == 0, first, np.where(share == 1, second, np.minimum(first, second)))
        smaller[~self.is_there] = 0.0
        return smaller
