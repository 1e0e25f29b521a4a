"""Keypoints of detectors elsewhere."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping

from fgpose.io.live.recordings import RecordedImage
from fgpose.live.cameras.camera import LiveCamera
from fgpose.live.cameras.clock_model import Stamp
from fgpose.live.cameras.image import SourceImage
from fgpose.live.processes.parts import Parts
from fgpose.live.processes.worker import HANGS_S, Worker
from fgpose.live.reception.keypoint_socket import KeypointSocket
from fgpose.live.reception.rejections import MessageError
from fgpose.people_observations import Detections

_LOOKS_S = 0.2


class KeypointReceiver:
    """A thread that gives messages of keypoints to their cameras. What is wrong with a message, its socket counts.

    Args:
        socket: from which it reads from now on; closed with it.
        cameras: whose source is ``zmq``.
        deliver: takes the detections with their times, in the thread.
        parts: told when the thread has ended.
    """

    def __init__(
        self,
        socket: KeypointSocket,
        cameras: Mapping[str, LiveCamera],
        deliver: Callable[[RecordedImage], None],
        parts: Parts | None = None,
    ) -> None:
        self._socket, self._cameras, self._deliver = socket, cameras, deliver
        self._looked_s = -math.inf
        socket.senders.on_contested = lambda name: cameras[name].contested()
        socket.on_refused = self._refused
        self._worker = Worker("the reception of keypoints", self._run, parts, hangs_after_s=HANGS_S)
        self._worker.start()

    def close(self) -> None:
        """Stop reading. Closing again does nothing."""
        self._worker.close()
        self._socket.close()

    def _run(self) -> None:
        while not self._worker.stopped.is_set():
            self._look()
            arrived = self._socket.receive(_LOOKS_S)
            if arrived is None:
                continue
            image = recorded_image(self._cameras[arrived.detections.camera], arrived.detections)
            if image is not None:
                self._deliver(image)

    def _refused(self, error: MessageError) -> None:
        """A message of unknown camera may be of any that is silent."""
        if error.camera in self._cameras:
            self._cameras[error.camera].refused(f"its messages are refused: {error.reason}")
        elif not error.camera:
            reason = f"no image comes, and messages whose camera is not known are refused: {error.reason}"
            for camera in self._cameras.values():
                camera.refused(reason)

    def _look(self) -> None:
        """Several times a second."""
        now_s = time.monotonic()
        if now_s >= self._looked_s + _LOOKS_S:
            self._looked_s = now_s
            for camera in self._cameras.values():
                camera.look()


def recorded_image(camera: LiveCamera, detections: Detections) -> RecordedImage | None:
    """Detections that have just arrived, at the time of their image by the clock of the live system; None: they are not
    to be used."""
    stamp = Stamp(detections.time_s, wall_s=detections.time_s)
    image = camera.receive(SourceImage(stamp=stamp, detections=detections))
    return None if image is None or image.detections is None else image.recorded(image.detections)
