"""Networks at work on the newest image of every camera, on all cores."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

import numpy as np

from fgpose.live.cameras import LiveCameras
from fgpose.live.image import Image
from fgpose.monocular.detected import detections_of
from fgpose.monocular.network import Network, Tracker
from fgpose.people import Detections

_LOG = logging.getLogger("fgpose.live")
_LOOKS_S = 0.2
_JOIN_S = 2.0


class Detectors:
    """Threads that look for people in the newest images, first of the camera that has waited longest.

    The network of a camera remembers the image before, so one thread at a time works on a camera. Nothing queues: where
    the networks are slower than the cameras, each camera's images are left out evenly.

    Args:
        cameras: whose newest images are looked at, and their rig. Images of detectors elsewhere are passed on.
        network: that looks for people; None where all detectors are elsewhere.
        deliver: takes each image and what was found in it, in the thread that looked.
        n_threads: at work at once.
        show: takes the name of the camera and its picture, RGB, before the network does.
    """

    def __init__(
        self,
        cameras: LiveCameras,
        network: Network | None,
        deliver: Callable[[Image, Detections], None],
        n_threads: int,
        show: Callable[[str, np.ndarray], None] | None = None,
    ) -> None:
        self._cameras, self._network, self._deliver, self._show = cameras, network, deliver, show
        self._calibrated = {camera.name: camera for camera in cameras.rig.cameras}
        self._trackers: dict[str, Tracker] = {}
        self._idle = set(self._calibrated)
        """Cameras at whose images no thread looks; changes with cameras.changed held."""
        self._looked_s: dict[str, float] = {}
        """When the image of each camera was taken at which a thread last looked."""
        self._failed: set[str] = set()
        self._stopped = threading.Event()
        self._threads = [
            threading.Thread(target=self._run, name=f"fgpose detector {n}", daemon=True) for n in range(n_threads)
        ]
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """Stop when the images at hand are done."""
        self._stopped.set()
        for thread in self._threads:
            thread.join(_JOIN_S)

    def _run(self) -> None:
        while not self._stopped.is_set():
            image = self._take()
            if image is not None:
                try:
                    self._look(image)
                finally:
                    with self._cameras.changed:
                        self._idle.add(image.camera)
                        self._cameras.changed.notify_all()

    def _take(self) -> Image | None:
        """The newest image of the camera whose last was taken first, of those at whose images no other thread looks."""
        with self._cameras.changed:
            self._cameras.changed.wait_for(lambda: self._waiting() or self._stopped.is_set(), _LOOKS_S)
            waiting = self._waiting()
            if not waiting:
                return None
            first = min(waiting, key=lambda image: self._looked_s.get(image.camera, -np.inf))
            self._idle.discard(first.camera)
            self._looked_s[first.camera] = first.captured_s
            return self._cameras[first.camera].mailbox.take()

    def _waiting(self) -> list[Image]:
        newest = (self._cameras[name].mailbox.peek() for name in self._idle)
        return [image for image in newest if image is not None]

    def _look(self, image: Image) -> None:
        if image.detections is not None:
            self._deliver(image, image.detections)
            return
        assert self._network is not None
        camera = self._calibrated[image.camera]
        try:
            if image.camera not in self._trackers:
                self._trackers[image.camera] = self._network.tracker(camera)
            picture = np.ascontiguousarray(image.picture[..., ::-1])
            if self._show is not None:
                self._show(image.camera, picture)
            found = self._trackers[image.camera].detect(picture)
        # Whatever is wrong with an image, the other cameras and the next image are not.
        except Exception:
            if image.camera not in self._failed:
                _LOG.exception("camera %s: the network failed on an image and begins anew", image.camera)
            self._failed.add(image.camera)
            self._trackers.pop(image.camera, None)
            return
        self._failed.discard(image.camera)
        self._deliver(image, detections_of(camera, image.captured_s, found))
