"""Pictures of cameras with the people in them, each of one moment.

A picture is there before its people are: the network looks at it, and other cameras are waited for. So it is shown when
the poses around its time are known, and until then the one before it.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import UInt8

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.live.frame import LiveFrame, LivePerson
from fgpose.overlay.drawing import Drawing, Pose
from fgpose.sampling import TIME_ROUNDING_S, between_images
from fgpose.skeleton import Skeleton

_SIZE_PX = 480  # the longer side
_JPEG_QUALITY = 70
# Between frames that are further apart nobody's way is known.
_GAP_S = 0.25
# A picture whose people are not known by then is shown without them.
_WAITS_S = 1.0
# Poses of this time are kept, and some pictures that wait for theirs.
_KEPT_S, _N_WAITING = 2.0, 8


@dataclass(frozen=True, eq=False)
class _Picture:
    image_rgb: np.ndarray
    """(height, width, 3) bytes"""
    time_s: float
    """NaN: not known."""
    poses: tuple[Pose, ...] = ()
    """Of the people when it was taken."""


class PicturesWithPeople:
    """The newest picture of each camera whose people are known. Any thread may use it.

    Args:
        rig: the cameras.
        skeleton: of the people.
    """

    def __init__(self, rig: CameraRig, skeleton: Skeleton) -> None:
        self._cameras = {camera.name: camera for camera in rig.cameras}
        self._drawing = Drawing(skeleton, ellipses=False, numbers=True)
        self._lock = threading.Lock()
        self._frames: deque[LiveFrame] = deque()
        """With increasing times."""
        self._waiting = {name: deque[_Picture](maxlen=_N_WAITING) for name in rig.names}
        self._newest: dict[str, _Picture] = {}
        """Whose people are known, or never will be."""

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
        """A picture that was taken at this Unix time; NaN: nobody knows when, and nobody is drawn.

        It is kept, not copied. Raises KeyError if the camera is unknown.
        """
        with self._lock:
            self._waiting[camera].append(_Picture(image_rgb, time_s))
            self._settle(camera)

    def jpeg(self, camera: str) -> bytes:
        """The picture, at most 480 pixels wide and high, with its people; empty if there is none."""
        with self._lock:
            picture, waiting = self._newest.get(camera), self._waiting[camera]
            if waiting and (picture is None or not waiting[-1].time_s < picture.time_s + _WAITS_S):
                picture = waiting[-1]
        return b"" if picture is None else self._drawn(self._cameras[camera], picture)

    def _settle(self, camera: str) -> None:
        """Whose people are known now."""
        waiting, newest_s = self._waiting[camera], self._frames[-1].time_s if self._frames else -np.inf
        while waiting:
            moment_s = waiting[0].time_s + self._cameras[camera].time_offset_s + self._motion_offset_s(camera)
            if moment_s > newest_s + TIME_ROUNDING_S:
                return
            picture = waiting.popleft()
            self._newest[camera] = _Picture(picture.image_rgb, picture.time_s, self._poses(moment_s))

    def _motion_offset_s(self, camera: str) -> float:
        """By how much later than calibration and clock say a picture was taken, as motion tells."""
        said = self._frames[-1].cameras if self._frames else ()
        return next((each.motion_offset_s or 0.0 for each in said if each.name == camera), 0.0)

    def _poses(self, moment_s: float) -> tuple[Pose, ...]:
        """Of everybody who is there before and after the moment: linear between both, the rest of the nearer one."""
        times_s = np.array([frame.time_s for frame in self._frames])
        after = int(np.searchsorted(times_s, moment_s - TIME_ROUNDING_S))
        if after == len(times_s):
            return ()
        if abs(times_s[after] - moment_s) <= TIME_ROUNDING_S:
            return tuple(_pose(person, person.positions_m) for person in self._frames[after].people)
        if after == 0 or times_s[after] - times_s[after - 1] > _GAP_S:
            return ()
        around_s = times_s[after - 1 : after + 1]
        earlier, later = (_by_number(self._frames[each].people) for each in (after - 1, after))
        nearer = earlier if moment_s - around_s[0] < around_s[1] - moment_s else later
        poses = []
        for number in sorted(earlier.keys() & later.keys()):
            both_m = np.stack([earlier[number].positions_m, later[number].positions_m])
            positions_m = between_images(around_s, both_m, np.array([moment_s]))[0]
            poses.append(_pose(nearer[number], positions_m))
        return tuple(poses)

    def _drawn(self, camera: Camera, picture: _Picture) -> bytes:
        import cv2

        height, width = picture.image_rgb.shape[:2]
        scale = min(1.0, _SIZE_PX / max(height, width))
        size_px = max(1, round(scale * width)), max(1, round(scale * height))
        small = cv2.resize(picture.image_rgb, size_px, interpolation=cv2.INTER_AREA)
        for pose in picture.poses:
            self._drawing.add(small, camera, pose, size_px[0] / camera.size_px[0])
        bgr = cv2.cvtColor(small, cv2.COLOR_RGB2BGR)
        return cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1].tobytes()


def _by_number(people: Sequence[LivePerson]) -> dict[int, LivePerson]:
    return {person.person: person for person in people}


def _pose(person: LivePerson, positions_m: np.ndarray) -> Pose:
    return Pose(person.person, positions_m, person.status, None)
