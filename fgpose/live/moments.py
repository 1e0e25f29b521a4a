"""Images of several cameras that belong to one moment: they enter the estimate together.

An image that enters alone costs an update of everybody's estimate. So the images of a moment wait for each other, but
never longer than a camera that is slow or silent could make them.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection

import numpy as np

from fgpose.people import Detections

# Of the time between the images of a camera: so long the images of a moment wait for each other. One that comes while
# the estimate is busy waits longer, so that a slow machine makes fewer and larger moments.
_WAITS_PERIODS = 0.5
_FIRST_PERIOD_S = 1 / 30
# Of so many images the usual time between them is the median.
_REMEMBERED = 30


class Moments:
    """Gathers detections as they come, and gives those of a moment when it is complete, or has waited long enough."""

    def __init__(self) -> None:
        self._waiting: dict[str, Detections] = {}
        self._began_s = np.inf
        """When the first that waits came."""
        self._captured_s: dict[str, float] = {}
        """Time of the newest image of each camera that was given."""
        self._periods_s: dict[str, deque[float]] = {}

    @property
    def period_s(self) -> float:
        """Usual time between the images of the fastest camera."""
        medians_s = [float(np.median(own)) for own in self._periods_s.values() if own]
        return min(medians_s, default=_FIRST_PERIOD_S)

    def add(self, detections: Detections, now_s: float) -> list[list[Detections]]:
        """Take the detections of an image.

        Returns:
            Moments that are complete because of it: those before, where the image is of a later one; an image that is
            older than what was given is a moment of its own.
        """
        camera, time_s = detections.camera, detections.time_s
        self._note(camera, time_s)
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
        is_complete = self._waiting.keys() >= set(expected)
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

    def _note(self, camera: str, time_s: float) -> None:
        before_s = self._captured_s.get(camera, np.inf)
        if time_s > before_s:
            self._periods_s.setdefault(camera, deque(maxlen=_REMEMBERED)).append(time_s - before_s)
        self._captured_s[camera] = time_s
