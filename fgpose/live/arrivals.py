"""Where detections wait for the tracker."""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Iterable

from fgpose.io.live_recordings import RecordedImage

# Of each camera. Older ones are left out: what follows is newer.
_MAX_WAITING = 2


class Arrivals:
    """Detections as they come from any thread, a few of each camera; nothing queues.

    Args:
        camera_names: all cameras.
    """

    def __init__(self, camera_names: Iterable[str]) -> None:
        self._waiting: dict[str, deque[RecordedImage]] = {name: deque() for name in camera_names}
        self._changed = threading.Condition()
        self._n_left_out: Counter[str] = Counter()

    def put(self, image: RecordedImage) -> None:
        """Add the detections of an image, in place of the oldest of its camera if there are too many."""
        waiting = self._waiting[image.detections.camera]
        with self._changed:
            if len(waiting) == _MAX_WAITING:
                waiting.popleft()
                self._n_left_out[image.detections.camera] += 1
            waiting.append(image)
            self._changed.notify_all()

    def take(self, timeout_s: float) -> list[RecordedImage]:
        """See Feed.take."""
        with self._changed:
            self._changed.wait_for(lambda: any(self._waiting.values()), timeout_s)
            images = [image for waiting in self._waiting.values() for image in waiting]
            for waiting in self._waiting.values():
                waiting.clear()
        return sorted(images, key=lambda image: image.detections.time_s)

    def n_left_out(self, camera: str) -> int:
        """Detections that were replaced by newer ones."""
        return self._n_left_out[camera]
