"""Cameras and the network that looks at their images, in a process of their own: the side of that process."""

from __future__ import annotations

import logging
import time
import warnings
from collections.abc import Callable
from logging.handlers import QueueHandler
from typing import Any

import numpy as np
from jaxtyping import UInt8

from fgpose.child_process import parent
from fgpose.live.cameras.running import LiveCameras
from fgpose.live.clock import Clock
from fgpose.live.pictures_with_people import small_picture
from fgpose.live.processes.camera_messages import Begin, CameraJob, Opened, SmallPicture
from fgpose.live.processes.detectors import Detectors
from fgpose.live.processes.parts import Parts
from fgpose.live.processes.priority import threads_give_way
from fgpose.live.processes.worker import PartEndedError, Worker
from fgpose.monocular.network import Network

STATUS_S = 0.1
"""Between two messages of how the cameras are."""
# Of pictures to look at there are a few each second.
_INTERVAL_S = 0.3


def serve() -> None:
    """Do what CameraProcess sends, until it is closed."""
    with parent() as (receive, send):
        job: CameraJob = receive()
        logger = logging.getLogger("fgpose")
        logger.setLevel(logging.INFO)
        logger.addHandler(_Sender(send))
        try:
            # Whoever started this process has opened the network before, and said what there is to say.
            with threads_give_way(), warnings.catch_warnings(action="ignore", category=UserWarning):
                network = job.open_network()
            clock = Clock(job.unix_minus_monotonic_s)
            parts = Parts(clock.now_s, on_restart=send)
            cameras, said = _opened(job, clock, parts, send)
        # Raised by CameraProcess.opened.
        except Exception as error:
            send(error)
            return
        send(Opened(cameras.rig, cameras.playback.period_s, said, tuple(cameras.awaited)))
        begin: Begin = receive()
        cameras.playback.begin(begin.start_s, begin.period_s)
        _serve(cameras, network, job, parts, receive, send)


def _opened(
    job: CameraJob, clock: Clock, parts: Parts, send: Callable[[object], None]
) -> tuple[LiveCameras, tuple[str, ...]]:
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", UserWarning)
        cameras = LiveCameras(job.live_rig, clock, job.late_s, send, parts=parts, is_known=job.is_known)
    return cameras, tuple(str(warning.message) for warning in said if issubclass(warning.category, UserWarning))


def _serve(
    cameras: LiveCameras,
    network: Network,
    job: CameraJob,
    parts: Parts,
    receive: Callable[[], Any],
    send: Callable[[object], None],
) -> None:
    def tell() -> None:
        while not telling.stopped.wait(STATUS_S):
            send(cameras.statuses())
            if hung := detectors.hung():
                send(PartEndedError(f"the network does not answer for an image of {', '.join(hung)}"))

    telling = Worker(f"telling of {', '.join(cameras.cameras)}", tell, parts)
    show = (
        _ShownPictures(lambda camera, picture, time_s: send(SmallPicture(camera, picture, time_s)))
        if job.has_viewer
        else None
    )
    with cameras:
        detectors = Detectors(cameras, network, send, job.n_detectors, show, parts)
        telling.start()
        try:
            while True:
                detectors.go_on(receive())
        except EOFError:
            telling.stopped.set()
            detectors.close()
            telling.close()


class _ShownPictures:
    """Scales some of the pictures of every camera down, and gives them on.

    Args:
        show: takes the name of the camera, the small picture, RGB, and when it was taken.
    """

    def __init__(self, show: Callable[[str, np.ndarray, float], None]) -> None:
        self._show = show
        self._shown_s: dict[str, float] = {}

    def __call__(self, camera: str, picture_rgb: UInt8[np.ndarray, "height width 3"], time_s: float) -> None:
        """A picture of a camera. Those of one camera come from one thread at a time."""
        now_s = time.monotonic()
        if now_s < self._shown_s.get(camera, -np.inf) + _INTERVAL_S:
            return
        self._shown_s[camera] = now_s
        self._show(camera, small_picture(picture_rgb), time_s)


class _Sender(QueueHandler):
    """Sends what is logged, ready to be pickled."""

    def __init__(self, send: Callable[[object], None]) -> None:
        super().__init__(send)  # pyrefly: ignore[bad-argument-type]
        self._send = send

    def enqueue(self, record: logging.LogRecord) -> None:
        self._send(record)
