"""Which images belong to one frame, whatever the frame rates of the cameras, and which detections to one person."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from fgpose.sampling import mean_times_s, nearest
from fgpose.shown import Shown

NO_IMAGE = -1
"""In place of the number of an image: the camera has none in this frame."""
NOBODY = -1
"""In place of the number of a detection: the person, or the joint, is not found in this image."""

# An image belongs to the nearest frame, at most half a frame away; a tenth more, as containers round time stamps to
# milliseconds.
_REACH = 0.6
# A walking person moves by 2 mm in this time.
_SAME_TIME_S = 1e-3


@dataclass(frozen=True, eq=False, repr=False)
class MatchedFrames(Shown):
    """The frames of several cameras together."""

    time_s: np.ndarray
    """(T,), or (T, C) where cameras of the same frame differ by more than a millisecond; NaN: no image."""
    image: Int[np.ndarray, "frame camera"]
    """Index of the image that each camera contributes, or NO_IMAGE."""

    @property
    def frame_time_s(self) -> Float[np.ndarray, " frame"]:
        """One time per frame: the mean over the cameras where they differ."""
        return self.time_s if self.time_s.ndim == 1 else mean_times_s(self.time_s)

    def part(self, frames: slice) -> tuple[MatchedFrames, list[Int[np.ndarray, " _images"]]]:
        """Some of the frames, and of each camera the images that are left, by which these frames count."""
        image, used = self.image[frames].copy(), list[np.ndarray]()
        for of_camera in image.T:
            there = of_camera != NO_IMAGE
            left, of_camera[there] = np.unique(of_camera[there], return_inverse=True)
            used.append(left)
        return MatchedFrames(self.time_s[frames], image), used

    def subset(self, cameras: Sequence[int]) -> MatchedFrames:
        """All frames, with the images of some of the cameras. A frame without any of them keeps its time."""
        if self.time_s.ndim == 1:
            return MatchedFrames(self.time_s, self.image[:, cameras])
        time_s = self.time_s[:, cameras]
        empty = np.isnan(time_s).all(axis=1)
        time_s[empty] = self.frame_time_s[empty, None]
        return MatchedFrames(time_s, self.image[:, cameras])


def match_frames(times_s: Sequence[Float[np.ndarray, " _images"]]) -> MatchedFrames:
    """Frames at the times of the fastest camera's images; a slower camera has no image in some of them.

    Where the fastest camera has no image near (it began later, ended earlier, or dropped one), those of the others make
    frames of their own. Each image is used at most once.

    Args:
        times_s: of each camera its images' times, increasing; possibly none.

    Raises:
        ValueError: no camera has an image.
    """
    if not any(map(len, times_s)):
        raise ValueError("no camera has an image")
    step_s = min(_interval_s(own_s) for own_s in times_s)
    clock_s = _clock(times_s, _REACH * step_s)
    image = np.full((len(clock_s), len(times_s)), NO_IMAGE)
    own_time_s = np.full(image.shape, np.nan)
    for camera, own_s in enumerate(times_s):
        frame = nearest(own_s, clock_s)
        distance_s = np.abs(own_s - clock_s[frame]) if len(own_s) else own_s
        # The nearest image is written last.
        order = np.argsort(-distance_s, kind="stable")
        order = order[distance_s[order] <= _REACH * step_s]
        image[frame[order], camera] = order
        own_time_s[frame[order], camera] = own_s[order]
    return MatchedFrames(_shared_if_same(own_time_s, clock_s), image)


def _interval_s(own_s: np.ndarray) -> float:
    """Mean time between images: single stamps may be rounded."""
    return float((own_s[-1] - own_s[0]) / (len(own_s) - 1)) if len(own_s) > 1 else np.inf


def _clock(times_s: Sequence[np.ndarray], reach_s: float) -> np.ndarray:
    """Times of all images but those within reach of an image of a faster camera."""
    by_rate = sorted(times_s, key=lambda own_s: (_interval_s(own_s), -len(own_s)))
    clock_s = np.zeros(0)
    for own_s in by_rate:
        far = own_s
        if len(clock_s) and len(own_s):
            far = own_s[np.abs(own_s - clock_s[nearest(own_s, clock_s)]) > reach_s]
        clock_s = np.sort(np.concatenate([clock_s, far]))
    return clock_s


def _shared_if_same(own_time_s: np.ndarray, clock_s: np.ndarray) -> np.ndarray:
    deviation_s = np.abs(own_time_s - clock_s[:, None])
    if np.nanmax(deviation_s) <= _SAME_TIME_S:
        return clock_s
    # Where dropped images leave frames closer together than usual, means of different cameras may change places.
    return own_time_s if (np.diff(mean_times_s(own_time_s)) > 0).all() else clock_s


SeenInImage = tuple[int, int, np.ndarray, np.ndarray]
"""Frame, camera, and for every joint of a person the number of the detection and that of its joint."""


@dataclass(frozen=True, eq=False, repr=False)
class Seen(Shown):
    """Which joint of which detection is which joint of a person, from the first to the last frame that shows them."""

    first_frame: int
    detection: np.ndarray
    """(T, C, J) number of the detection in its image, or NOBODY."""
    joint: np.ndarray
    """(T, C, J) number of its joint."""

    @property
    def frames(self) -> slice:
        """Of the recording."""
        return slice(self.first_frame, self.first_frame + len(self.detection))

    @staticmethod
    def nothing(n_frames: int, n_cameras: int, n_joints: int) -> Seen:
        """Of nobody."""
        shape = (n_frames, n_cameras, n_joints)
        return Seen(0, np.full(shape, NOBODY), np.zeros(shape, dtype=int))

    @staticmethod
    def of_images(images: Sequence[SeenInImage], n_cameras: int) -> Seen:
        """From all images that show somebody, at least one."""
        first = min(t for t, *_ in images)
        shape = (max(t for t, *_ in images) + 1 - first, n_cameras, len(images[0][2]))
        seen = Seen(first, np.full(shape, NOBODY), np.zeros(shape, dtype=int))
        for t, c, detection, joint in images:
            seen.detection[t - first, c], seen.joint[t - first, c] = detection, joint
        return seen

    @property
    def main_detection(self) -> Int[np.ndarray, "frame camera"]:
        """The detection from which most joints are, or NOBODY."""
        same = self.detection[..., :, None] == self.detection[..., None, :]
        number = np.where(self.detection != NOBODY, same.sum(axis=-1), 0)
        return np.take_along_axis(self.detection, np.argmax(number, axis=-1)[..., None], axis=-1)[..., 0]

    def in_frames(self, n_frames: int) -> Seen:
        """From the first frame of the recording on."""
        whole = Seen.nothing(n_frames, *self.detection.shape[1:])
        whole.detection[self.frames], whole.joint[self.frames] = self.detection, self.joint
        return whole
