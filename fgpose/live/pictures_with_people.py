"""Pictures of cameras with the people who were there when they were taken.

A picture is there before its people are: the network looks at it, and other cameras are waited for. So it waits until
the poses around its time are known.
"""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import UInt8

from fgpose.geometry.camera import CameraRig
from fgpose.live.frame import LiveFrame, LivePerson
from fgpose.sampling import TIME_ROUNDING_S, between_images

# Between frames that are further apart nobody's way is known; a frame that is so near is of the same moment, where a
# computer is too slow for others. Somebody who walks moves by 3 cm.
_GAP_S, _NEAR_S = 0.25, 0.02
# A picture whose people are not known by then is shown without them.
_WAITS_S = 1.0
# Frames of this time are kept, and some pictures that wait for theirs.
_KEPT_S, _N_WAITING = 2.0, 8
_SIZE_PX = 480  # of a small one, the longer side


@dataclass(frozen=True, eq=False)
class PictureWithPeople:
    """A picture of a camera and the people in it."""

    image_rgb: np.ndarray
    """(height, width, 3) bytes, perhaps scaled down."""
    time_s: float
    """When it was taken as the camera says it, Unix time; NaN: not known."""
    moment_s: float = np.nan
    """The same as calibration and motion correct it: the people are those of then."""
    people: tuple[LivePerson, ...] = ()


def small_picture(picture_rgb: UInt8[np.ndarray, "height width 3"]) -> UInt8[np.ndarray, "small_height small_width 3"]:
    """As large as a page or a viewer shows it: at most 480 pixels wide and high."""
    import cv2

    height, width = picture_rgb.shape[:2]
    scale = min(1.0, _SIZE_PX / max(height, width))
    size_px = max(1, round(scale * width)), max(1, round(scale * height))
    return cv2.resize(picture_rgb, size_px, interpolation=cv2.INTER_AREA)


class PicturesWithPeople:
    """Brings pictures and people of one moment together. Any thread may use it.

    Args:
        rig: the cameras.
    """

    def __init__(self, rig: CameraRig) -> None:
        self._offset_s = {camera.name: camera.time_offset_s for camera in rig.cameras}
        self._lock = threading.Lock()
        self._frames: deque[LiveFrame] = deque()
        """With increasing times."""
        self._waiting = {name: deque[PictureWithPeople](maxlen=_N_WAITING) for name in rig.names}
        self._newest: dict[str, PictureWithPeople] = {}
        """Whose people are known, or never will be."""
        self._new: set[str] = set()
        """Cameras whose newest has not been taken."""

    @property
    def cameras(self) -> set[str]:
        """Of which there is a picture."""
        with self._lock:
            return {name for name, waiting in self._waiting.items() if waiting or name in self._newest}

    def add_frame(self, frame: LiveFrame) -> None:
        """What is known of people now."""
        with self._lock:
            newest_s = self._frames[-1].time_s if self._frames else -np.inf
            if frame.time_s < newest_s - _KEPT_S:
                # A clock was set, or a recording begins again.
                self._frames.clear()
            elif not frame.time_s > newest_s:
                return
            self._frames.append(frame)
            while self._frames[0].time_s < frame.time_s - _KEPT_S:
                self._frames.popleft()
            for camera in self._waiting:
                self._settle(camera)

    def add_picture(self, camera: str, image_rgb: UInt8[np.ndarray, "height width 3"], time_s: float) -> None:
        """A picture that was taken at this Unix time; NaN: nobody knows when, and it has no people.

        It is kept, not copied. Raises KeyError if the camera is unknown.
        """
        with self._lock:
            self._waiting[camera].append(PictureWithPeople(image_rgb, time_s))
            self._settle(camera)

    def newest(self, camera: str) -> PictureWithPeople | None:
        """The newest picture whose people are known, or, if these are more than a second behind, the newest of all."""
        with self._lock:
            picture, waiting = self._newest.get(camera), self._waiting[camera]
            if waiting and (picture is None or not waiting[-1].time_s < picture.time_s + _WAITS_S):
                return waiting[-1]
            return picture

    def take(self) -> dict[str, PictureWithPeople]:
        """The newest pictures whose people are known, by camera, of those that were not taken before."""
        with self._lock:
            taken, self._new = {name: self._newest[name] for name in self._new}, set()
            return taken

    def _settle(self, camera: str) -> None:
        """Whose people are known now."""
        waiting, newest_s = self._waiting[camera], self._frames[-1].time_s if self._frames else -np.inf
        while waiting:
            moment_s = waiting[0].time_s + self._offset_s[camera] + self._motion_offset_s(camera)
            if moment_s > newest_s + TIME_ROUNDING_S:
                return
            self._newest[camera] = replace(waiting.popleft(), moment_s=moment_s, people=self._people(moment_s))
            self._new.add(camera)

    def _motion_offset_s(self, camera: str) -> float:
        """By how much later than calibration and clock say a picture was taken, as motion tells."""
        said = self._frames[-1].cameras if self._frames else ()
        return next((each.motion_offset_s or 0.0 for each in said if each.name == camera), 0.0)

    def _people(self, moment_s: float) -> tuple[LivePerson, ...]:
        """Who is there before and after the moment: positions linear between both, the rest of the nearer one."""
        times_s = np.array([frame.time_s for frame in self._frames])
        if not len(times_s):
            return ()
        after, nearest = int(np.searchsorted(times_s, moment_s)), int(np.argmin(np.abs(times_s - moment_s)))
        apart_s = abs(times_s[nearest] - moment_s)
        is_between = 0 < after < len(times_s) and times_s[after] - times_s[after - 1] <= _GAP_S
        if apart_s <= (TIME_ROUNDING_S if is_between else _NEAR_S):
            return self._frames[nearest].people
        if not is_between:
            return ()
        around_s = times_s[after - 1 : after + 1]
        earlier, later = ({each.person: each for each in self._frames[at].people} for at in (after - 1, after))
        nearer = earlier if moment_s - around_s[0] < around_s[1] - moment_s else later
        people = []
        for number in sorted(earlier.keys() & later.keys()):
            both_m = np.stack([earlier[number].positions_m, later[number].positions_m])
            positions_m = between_images(around_s, both_m, np.array([moment_s]))[0]
            people.append(replace(nearer[number], positions_m=positions_m))
        return tuple(people)
