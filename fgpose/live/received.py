"""Keypoints of detectors elsewhere, on their way into the same mailboxes as images."""

from __future__ import annotations

import threading

from fgpose.live.cameras import LiveCameras
from fgpose.live.clock_model import Stamp
from fgpose.live.image import SourceImage
from fgpose.live.keypoint_socket import KeypointSocket

_LOOKS_S = 0.2


class KeypointReceiver:
    """A thread that gives messages of keypoints to their cameras. What is wrong with a message, its socket counts.

    Args:
        socket: from which it reads from now on; closed with it.
        cameras: whose source is ``zmq``.
    """

    def __init__(self, socket: KeypointSocket, cameras: LiveCameras) -> None:
        self._socket, self._cameras = socket, cameras
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="keypoints", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop reading. Closing again does nothing."""
        self._stopped.set()
        self._thread.join()

    def _run(self) -> None:
        with self._socket:
            while not self._stopped.is_set():
                arrived = self._socket.receive(_LOOKS_S)
                if arrived is None:
                    continue
                camera = self._cameras[arrived.detections.camera]
                stamp = Stamp(arrived.detections.time_s, wall_s=arrived.detections.time_s)
                image = camera.receive(SourceImage(stamp=stamp, detections=arrived.detections))
                if image is not None:
                    camera.mailbox.put(image)
