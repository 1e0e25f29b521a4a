"""Images of several cameras that belong to one moment: they enter the estimate together.

An image that enters alone costs an update of everybody's estimate, as much as all of a moment together. So the images
of a moment wait for each other, but never longer than a camera that is slow or silent could make them.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection
from statistics import median

import numpy as np

from fgpose.people_observations import Detections

_FIRST_PERIOD_S = 1 / 30
# So long the first of a moment waits. After one period it comes again and ends the wait, unless networks look at the
# next image only when this one was used: then these are what takes so long, and they take twice as long at times.
_WAITS_PERIODS = 2.0
# Of so many images, what is usual is the median.
_REMEMBERED = 30


class _Usual:
    """What a number of each camera usually is."""

    def __init__(self) -> None:
        self._last: dict[str, deque[float]] = {}
        self.of: dict[str, float] = {}

    def add(self, camera: str, value: float) -> None:
        last = self._last.setdefault(camera, deque(maxlen=_REMEMBERED))
        last.append(value)
        self.of[camera] = median(last)


class Moments:
    """Gathers detections as they come, and gives those of a moment when it is complete, when a camera comes again, or
    when it has waited for two of the usual times between images of the fastest camera. A camera whose images usually
    come later than one of these after those of the others is not waited for."""

    def __init__(self) -> None:
        self._waiting: dict[str, Detections] = {}
        self._began_s = np.inf
        """When the first that waits came."""
        self._captured_s: dict[str, float] = {}
        """Time of the newest image of each camera that was given."""
        self._periods_s, self._delays_s = _Usual(), _Usual()
        """Between two images of a camera, and from taking an image until its detections are here."""

    @property
    def period_s(self) -> float:
        """Usual time between the images of the fastest camera."""
        return min(self._periods_s.of.values(), default=_FIRST_PERIOD_S)

    def add(self, detections: Detections, now_s: float) -> list[list[Detections]]:
        """Take the detections of an image.

        Returns:
            Moments that are complete because of it: those before, where the image is of a later one; an image that is
            older than what was given is a moment of its own.
        """
        camera, time_s = detections.camera, detections.time_s
        self._note(camera, time_s, now_s)
        ready: list[list[Detections]] = []
        if self._waiting and (camera in self._waiting or self._is_apart(time_s)):
            ready.append(self._take())
        if not self._waiting:
            self._began_s = now_s
        self._waiting[camera] = detections
        return ready

    def ready(self, now_s: float, expected: Collection[str]) -> list[Detections]:
        """The moment that waits, if all of these cameras have come or it has waited long enough; else nothing."""
        if not self._waiting:
            return []
        is_complete = self._waiting.keys() >= self._in_time(expected)
        return self._take() if is_complete or now_s >= self.deadline_s else []

    @property
    def deadline_s(self) -> float:
        """When what waits is given in any case; inf: nothing waits."""
        return self._began_s + _WAITS_PERIODS * self.period_s if self._waiting else np.inf

    def _take(self) -> list[Detections]:
        taken, self._waiting, self._began_s = list(self._waiting.values()), {}, np.inf
        return sorted(taken, key=lambda detections: detections.time_s)

    def _is_apart(self, time_s: float) -> bool:
        times_s = [detections.time_s for detections in self._waiting.values()]
        return max(*times_s, time_s) - min(*times_s, time_s) > self.period_s

    def _in_time(self, camera_names: Collection[str]) -> set[str]:
        """Those of the cameras that usually come while the others wait."""
        delays_s = self._delays_s.of
        latest_s = min(delays_s.values(), default=0.0) + self.period_s
        return {name for name in camera_names if delays_s.get(name, 0.0) <= latest_s}

    def _note(self, camera: str, time_s: float, now_s: float) -> None:
        before_s = self._captured_s.get(camera, np.inf)
        if time_s > before_s:
            self._periods_s.add(camera, time_s - before_s)
        self._delays_s.add(camera, now_s - time_s)
        self._captured_s[camera] = time_s
