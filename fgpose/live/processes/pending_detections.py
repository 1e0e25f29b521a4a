"""Where detections wait for the tracker."""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Iterable

from fgpose.io.live.recordings import RecordedImage

# Of each camera. So much comes at 30 Hz while somebody new is found, or while the computer does something else.
_MAX_WAITING = 4
# If more than this waits again and again, the tracker does not keep up: what follows is newer.
_USUAL_WAITING = 2


class PendingDetections:
    """Detections as they come from any thread, a few of each camera: after a delay all are used, but nothing queues.

    Args:
        camera_names: all cameras.
    """

    def __init__(self, camera_names: Iterable[str]) -> None:
        self._waiting: dict[str, deque[RecordedImage]] = {name: deque() for name in camera_names}
        self._changed = threading.Condition()
        self._n_left_out: Counter[str] = Counter()
        self._was_behind = False

    def put(self, image: RecordedImage) -> None:
        """Add the detections of an image, in place of the oldest of its camera if there are too many."""
        waiting = self._waiting[image.detections.camera]
        with self._changed:
            waiting.append(image)
            self._leave_out(waiting, _MAX_WAITING)
            self._changed.notify_all()

    def is_any(self) -> bool:
        """Whether something waits."""
        return any(self._waiting.values())

    def take(self, timeout_s: float) -> list[RecordedImage]:
        """See Feed.take."""
        with self._changed:
            self._changed.wait_for(self.is_any, timeout_s)
            is_behind = any(len(waiting) > _USUAL_WAITING for waiting in self._waiting.values())
            if is_behind and self._was_behind:
                for waiting in self._waiting.values():
                    self._leave_out(waiting, _USUAL_WAITING)
            self._was_behind = is_behind
            images = [image for waiting in self._waiting.values() for image in waiting]
            for waiting in self._waiting.values():
                waiting.clear()
        return sorted(images, key=lambda image: image.detections.time_s)

    def _leave_out(self, waiting: deque[RecordedImage], at_most: int) -> None:
        """Those of a camera that are oldest."""
        while len(waiting) > at_most:
            self._n_left_out[waiting.popleft().detections.camera] += 1

    def n_left_out(self, camera: str) -> int:
        """Detections that were replaced by newer ones."""
        return self._n_left_out[camera]
