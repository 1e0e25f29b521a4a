"""A running system: images in, frames out, at a steady rate and whatever happens to a camera or a consumer."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Sequence
from typing import Protocol, runtime_checkable

import numpy as np

from fgpose.io.live_recordings import RecordedImage
from fgpose.live.cameras import LiveCameras
from fgpose.live.clock import Clock
from fgpose.live.detectors import Detectors
from fgpose.live.frame import CameraState, LiveFrame
from fgpose.live.image import Image
from fgpose.live.report import Report
from fgpose.live.tracking import LiveTracking, Update
from fgpose.monocular.network import Network
from fgpose.people import Detections

# Without images, frames are published this often: nobody may take silence for an empty room.
_SILENT_S = 0.1
# Detections that wait for the tracker, of each camera. Older ones are left out: what follows is newer.
_MAX_WAITING = 2
_EXPECTED = (CameraState.OK, CameraState.DOUBTFUL)


@runtime_checkable
class Consumer(Protocol):
    """Takes frames; it neither waits nor raises."""

    def publish(self, frame: LiveFrame) -> None: ...


class LiveSystem:
    """Detects, tracks and publishes until it is closed.

    Args:
        cameras: open already.
        tracking: of the same rig.
        network: that looks for people; None: all detectors are elsewhere.
        outputs: take every frame.
        observers: told of every update, as a recorder is; they do not wait.
        clock: of the cameras.
        n_detectors: images that the network works on at once.
        show: takes the name of a camera and its picture, RGB, of every image that the network looks at.
    """

    def __init__(
        self,
        cameras: LiveCameras,
        tracking: LiveTracking,
        network: Network | None,
        outputs: Sequence[Consumer],
        observers: Sequence[Callable[[Update], None]],
        clock: Clock,
        n_detectors: int,
        show: Callable[[str, np.ndarray], None] | None = None,
    ) -> None:
        self._cameras, self._tracking, self._clock = cameras, tracking, clock
        self._outputs, self._observers = tuple(outputs), tuple(observers)
        self.report = Report(cameras.rig.names)
        self._arrived: dict[str, deque[RecordedImage]] = {
            name: deque(maxlen=_MAX_WAITING) for name in cameras.rig.names
        }
        self._changed = threading.Condition()
        self._stopped = threading.Event()
        self._published_s = clock.now_s()
        self._detectors = Detectors(cameras, network, self._deliver, n_detectors, show)

    def run(self, until_s: float = float("inf")) -> None:
        """Track and publish in this thread until stopped, or until a time."""
        while not self._stopped.is_set() and self._clock.now_s() < until_s:
            images = self._wait()
            expected = [status.name for status in self._cameras.statuses() if status.state in _EXPECTED]
            for image in images:
                self._tell(self._tracking.add(image, self._clock.now_s()))
            self._tell(self._tracking.look(self._clock.now_s(), expected))
            if self._clock.now_s() >= self._published_s + _SILENT_S:
                self._publish()

    def stop(self) -> None:
        """Let run return; from any thread."""
        self._stopped.set()
        with self._changed:
            self._changed.notify_all()

    def close(self) -> None:
        """Stop everything but the cameras."""
        self.stop()
        self._detectors.close()
        self._tracking.close()

    def _deliver(self, image: Image, detections: Detections) -> None:
        stamp = image.source.stamp
        stamp_s = None if stamp is None else stamp.stamp_s
        with self._changed:
            waiting = self._arrived[image.camera]
            if len(waiting) == waiting.maxlen:
                self._cameras[image.camera].n_lost += 1
            waiting.append(RecordedImage(detections, image.arrived_s, stamp_s))
            self._changed.notify_all()

    def _wait(self) -> list[RecordedImage]:
        """Detections that have come, in the order in which their images were taken; none where it is time for
        something else."""
        now_s = self._clock.now_s()
        wait_s = min(self._tracking.deadline_s, self._published_s + _SILENT_S) - now_s
        with self._changed:
            self._changed.wait_for(lambda: any(self._arrived.values()) or self._stopped.is_set(), max(wait_s, 0.0))
            images = [image for waiting in self._arrived.values() for image in waiting]
            for waiting in self._arrived.values():
                waiting.clear()
        return sorted(images, key=lambda image: image.detections.time_s)

    def _tell(self, updates: Sequence[Update]) -> None:
        for update in updates:
            for image in update.images:
                camera = self._cameras[image.detections.camera]
                camera.n_used, camera.n_lost = camera.n_used + image.is_used, camera.n_lost + (not image.is_used)
            for observe in self._observers:
                observe(update)
            if any(image.is_used for image in update.images):
                self._publish()

    def _publish(self) -> None:
        now_s = self._published_s = self._clock.now_s()
        frame = self._tracking.frame(now_s, self._cameras.statuses())
        for output in self._outputs:
            output.publish(frame)
        self.report.add(frame)
