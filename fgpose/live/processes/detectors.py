"""Networks at work on the images of every camera, on all cores."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterable

import numpy as np

from fgpose.io.live.recordings import RecordedImage
from fgpose.live.cameras.image import Image
from fgpose.live.cameras.running import LiveCameras
from fgpose.live.processes.parts import Parts
from fgpose.live.processes.priority import give_way
from fgpose.live.processes.worker import Worker
from fgpose.monocular.detected import detections_of
from fgpose.monocular.network import Network, Tracker, people_in

_LOG = logging.getLogger("fgpose.live")
_LOOKS_S = 0.2
_JOIN_S = 2.0
# A network that takes so long for one image does not come back. The first image may take seconds.
_HANGS_S = 10.0
# A tenth of the share of a core that others get who want it too.
_NICE = 10


class Detectors:
    """Threads that look for people in images, first of the camera that has waited longest.

    The network of a camera remembers the image before, so one thread at a time works on a camera. The next image of a
    camera is the newest when it is told to go on: when what was found in the one before is used. So nothing queues, and
    where networks or tracker are slower than the cameras, images of all cameras are left out evenly. Cameras that are
    told together are looked at as they were at that moment, one after the other: images that were taken at different
    times, 0.1 s apart, would show hands and feet at different places.

    Args:
        cameras: whose images are looked at, and their rig.
        network: that looks for people.
        deliver: takes what was found in each image, in the thread that looked.
        n_threads: at work at once.
        show: takes the name of the camera, its picture, RGB, and when it was taken, before the network does.
        parts: told when a thread has ended.
    """

    def __init__(
        self,
        cameras: LiveCameras,
        network: Network,
        deliver: Callable[[RecordedImage], None],
        n_threads: int,
        show: Callable[[str, np.ndarray, float], None] | None = None,
        parts: Parts | None = None,
    ) -> None:
        self._cameras, self._network, self._deliver, self._show = cameras, network, deliver, show
        self._calibrated = {camera.name: camera for camera in cameras.rig.cameras}
        self._trackers: dict[str, Tracker] = {}
        self._idle = set(self._calibrated)
        """Cameras whose next image may be looked at; changes with cameras.changed held."""
        self._next: dict[str, Image] = {}
        """Their images when they were told to go on; those of others had no new one and may come yet."""
        self._looked_s: dict[str, float] = {}
        """When the image of each camera was taken at which a thread last looked."""
        self._began_s: dict[str, float] = {}
        """When a thread began to look at the image at which it looks now, of time.monotonic."""
        self._failed: set[str] = set()
        self._stopped = threading.Event()
        self._workers = [Worker(f"detector {n}", self._run, parts) for n in range(n_threads)]
        for worker in self._workers:
            worker.start()

    def go_on(self, camera_names: Iterable[str]) -> None:
        """What was found in the newest images of these cameras is used."""
        with self._cameras.changed:
            self._idle.update(camera_names)
            for name in self._idle - self._next.keys():
                newest = self._cameras.mailboxes[name].take()
                if newest is not None:
                    self._next[name] = newest
            self._cameras.changed.notify_all()

    def hung(self) -> list[str]:
        """Cameras for whose image the network does not answer. A thread cannot be ended: only the process can."""
        now_s = time.monotonic()
        return [camera for camera, began_s in self._began_s.copy().items() if now_s - began_s > _HANGS_S]

    def close(self) -> None:
        """Stop when the images at hand are done."""
        self._stopped.set()
        for worker in self._workers:
            worker.close(_JOIN_S)

    def _run(self) -> None:
        # An image at which no network looks is left out, one that is decoded late makes all that follow late.
        give_way(_NICE)
        while not self._stopped.is_set():
            image, is_looked_at = self._take(), False
            if image is None:
                continue
            self._began_s[image.camera] = time.monotonic()
            try:
                is_looked_at = self._look(image)
            finally:
                del self._began_s[image.camera]
                if not is_looked_at:
                    self.go_on([image.camera])

    def _take(self) -> Image | None:
        """The next image of the camera whose last was taken first, of those at whose images no other thread looks."""
        with self._cameras.changed:
            self._cameras.changed.wait_for(lambda: self._waiting() or self._stopped.is_set(), _LOOKS_S)
            waiting = self._waiting()
            if not waiting:
                return None
            first = min(waiting, key=lambda image: self._looked_s.get(image.camera, -np.inf))
            self._idle.discard(first.camera)
            self._looked_s[first.camera] = first.captured_s
            return self._next.pop(first.camera, None) or self._cameras.mailboxes[first.camera].take()

    def _waiting(self) -> list[Image]:
        images = (self._next.get(name) or self._cameras.mailboxes[name].peek() for name in self._idle)
        return [image for image in images if image is not None]

    def _look(self, image: Image) -> bool:
        """Deliver what is found in an image; whether the network could look at it."""
        camera = self._calibrated[image.camera]
        try:
            if image.camera not in self._trackers:
                self._trackers[image.camera] = self._network.tracker(camera)
            if self._show is not None:
                self._show(image.camera, image.picture, image.captured_s)
            found = people_in(image.picture, self._trackers[image.camera], self._network)
        # Whatever is wrong with an image, the other cameras and the next image are not.
        except Exception:
            if image.camera not in self._failed:
                _LOG.exception("camera %s: the network failed on an image and begins anew", image.camera)
            self._failed.add(image.camera)
            self._trackers.pop(image.camera, None)
            return False
        self._failed.discard(image.camera)
        self._deliver(image.recorded(detections_of(camera, image.captured_s, found)))
        return True
