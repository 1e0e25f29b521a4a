"""The live input: whole frames, and images of one camera, which are assigned to frames."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from fgpose.observations import Observations
from fgpose.sampling import Pace
from fgpose.skeleton import Skeleton

# Nearly a whole step: a frame then has an image of every camera, and the cameras confirm each other. With half a step,
# four cameras at different times of their step had an error 4 to 8 % (occluded: 26 %) above that of synchronous ones.
_NEW_FRAME_STEPS = 0.9
_SLOWEST_STEP_S = 1.0
# So many frames tell that cameras take turns.
_TURNS = 12


class TooLateError(ValueError):
    """No frame in the window can take what has come."""


class Arrivals:
    """Images of unsynchronised cameras, gathered to frames.

    An image begins a new frame if it is the second of its camera or nearly a usual step later, and joins the newest
    frame otherwise: four cameras of 50 Hz, each at its own time, make 50 frames a second, not 200. One that is older
    than the newest frame joins the nearest frame, at most a usual step away, that has none of its camera yet.

    Args:
        camera_names: of all cameras.
        warns: of times in another unit; else another one does, of the same images.
    """

    def __init__(self, camera_names: tuple[str, ...], *, warns: bool = True) -> None:
        self._names = camera_names
        self._last_s = np.full(len(camera_names), np.nan)
        self.pace = Pace(warns=warns)

    @property
    def usual_step_s(self) -> float:
        """Usual time from one image of a camera to its next; a second until a camera has given two."""
        return self.pace.usual_step_s or _SLOWEST_STEP_S

    def frame_of(
        self,
        camera: int,
        time_s: float,
        frame_time_s: Float[np.ndarray, " frame"],
        image_time_s: Float[np.ndarray, "frame camera"],
    ) -> int | None:
        """Number of the frame that an image joins; None: it begins a new one.

        Args:
            camera: number of the camera.
            time_s: when it took the image.
            frame_time_s: times of the frames in the window, increasing.
            image_time_s: when each camera took its image of each frame; NaN: there is none yet.

        Raises:
            ValueError: the image has been there before.
            TooLateError: no frame is near that has none of its camera.
        """
        own_s, name = image_time_s[:, camera], self._names[camera]
        if (own_s == time_s).any():
            raise ValueError(f"camera {name} gave an image at {time_s:.13g} s before; this one was not used")
        newer_s = time_s - frame_time_s[-1] if len(frame_time_s) else np.inf
        if (
            np.isinf(newer_s)
            or newer_s > _NEW_FRAME_STEPS * self.usual_step_s
            or (newer_s > 0 and np.isfinite(own_s[-1]))
        ):
            return None
        apart_s = np.where(np.isnan(own_s), np.abs(frame_time_s - time_s), np.nan)
        if not (apart_s <= self.usual_step_s).any():
            newest_s = np.where(np.isnan(image_time_s[-1]), -np.inf, image_time_s[-1])
            ahead = int(np.argmax(newest_s))
            raise TooLateError(
                f"camera {name}: no frame near {time_s:.13g} s waits for its image; the window begins at "
                f"{frame_time_s[0]:.13g} s, and the newest image is of {self._names[ahead]}, "
                f"{newest_s[ahead] - time_s:.3g} s ahead; the image was not used. Is one of their clocks another?"
            )
        return int(np.nanargmin(apart_s))

    def took(self, time_s: Float[np.ndarray, " camera"]) -> None:
        """Learn the usual step from images that were used: the time of that of each camera; NaN: there was none."""
        steps_s = (time_s - self._last_s)[time_s > self._last_s].tolist()
        for step_s in steps_s:
            self.pace.add(step_s)
        self._last_s = np.fmax(self._last_s, time_s)


class Turns:
    """Whether cameras take turns, in frames that claim an image of each: one alone shows somebody, and it is mostly
    another one than in the frame before. The images of the others are then those of earlier moments, left empty."""

    def __init__(self) -> None:
        self._alone: deque[int] = deque(maxlen=_TURNS)

    def taken_s(
        self, shows: Bool[np.ndarray, " camera"], taken_s: Float[np.ndarray, " camera"]
    ) -> Float[np.ndarray, " camera"]:
        """When each camera took its image of a new frame; NaN: there is none.

        Args:
            shows: whether it shows somebody.
            taken_s: as the frame says.
        """
        n_changes = np.count_nonzero(np.diff(self._alone))
        is_turn = len(self._alone) == _TURNS and n_changes > _TURNS / 2 and shows.sum() == 1
        return np.where(shows, taken_s, np.nan) if is_turn else taken_s

    def add(self, shows: Bool[np.ndarray, " camera"]) -> None:
        """Learn from a frame that was used."""
        if shows.sum() > 1:
            self._alone.clear()
        elif shows.any():
            self._alone.append(int(np.argmax(shows)))


def with_image(frame: Observations, image: Observations, of_image: Bool[np.ndarray, " camera"]) -> Observations:
    """The frame with the detections of these cameras replaced by those of the image; both have all cameras of the
    rig."""

    def taken(ours: np.ndarray | None, theirs: np.ndarray | None) -> Any:  # an array, or None
        if ours is None and theirs is None:
            return None
        own = np.nan if ours is None else ours
        other = np.nan if theirs is None else theirs
        n_axes = np.ndim(own if theirs is None else other)
        return np.where(of_image.reshape(1, -1, *(1,) * (n_axes - 2)), other, own)

    detections = image.per_detection(lambda array: array)
    own = frame.per_detection(lambda array: array)
    return replace(frame, **{name: taken(own[name], detections[name]) for name in own})


def check_frame(frame: Observations, skeleton: Skeleton) -> None:
    """Raise ValueError unless this is one frame of the skeleton."""
    if frame.n_frames != 1:
        raise ValueError(f"update takes one frame at a time, got {frame.n_frames}; use observations.frames(...)")
    if frame.skeleton != skeleton:
        raise ValueError(f"the frame has skeleton {frame.skeleton.name}, the estimator {skeleton.name}")


def check_later(frame: Observations, newest_s: float) -> None:
    """Raise TooLateError unless this frame is later than the newest."""
    if frame.frame_time_s[0] <= newest_s:
        raise TooLateError(
            f"time must increase: got a frame at {frame.frame_time_s[0]:.13g} s after one at {newest_s:.13g} s; "
            "it was not used"
        )


def one_frame(
    skeleton: Skeleton,
    time_s: float | np.ndarray,
    camera_names: tuple[str, ...],
    arrays: Sequence[np.ndarray | float | None],
) -> Observations:
    """Observations of one frame from points2d_px, confidence, points3d_m and covariance3d_m2, whose first axis is the
    camera. Raises ValueError as Observations does."""
    points2d_px, confidence, points3d_m, covariance3d_m2 = map(_with_axis, arrays)
    return Observations(
        skeleton=skeleton,
        time_s=np.asarray(time_s, dtype=float)[None],
        points2d_px=np.asarray(points2d_px),
        confidence=np.asarray(confidence),
        points3d_m=None if points3d_m is None else np.asarray(points3d_m),
        camera_names=camera_names,
        covariance3d_m2=None if covariance3d_m2 is None else np.asarray(covariance3d_m2),
    )


def one_image(
    skeleton: Skeleton, time_s: float, camera_name: str, arrays: Sequence[np.ndarray | float | None]
) -> Observations:
    """one_frame for arrays of one camera, without its axis."""
    return one_frame(skeleton, time_s, (camera_name,), [_with_axis(array) for array in arrays])


def _with_axis(array: np.ndarray | float | None) -> np.ndarray | float | None:
    """With a first axis of length one, unless it is the same for everything."""
    return array if array is None or np.ndim(array) == 0 else np.asarray(array)[None]
