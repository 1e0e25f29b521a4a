"""Cameras and the network that looks at their images, in a process of their own: the side of that process."""

from __future__ import annotations

import logging
import threading
import warnings
from collections.abc import Callable
from logging.handlers import QueueHandler
from typing import Any

from fgpose.child_process import parent
from fgpose.live.camera_messages import Begin, CameraJob, Opened, SmallPicture
from fgpose.live.cameras import LiveCameras
from fgpose.live.clock import Clock
from fgpose.live.detectors import Detectors
from fgpose.live.shown import ShownPictures
from fgpose.monocular.network import Network

STATUS_S = 0.1
"""Between two messages of how the cameras are."""


def serve() -> None:
    """Do what CameraProcess sends, until it is closed."""
    with parent() as (receive, send):
        job: CameraJob = receive()
        logger = logging.getLogger("fgpose")
        logger.setLevel(logging.INFO)
        logger.addHandler(_Sender(send))
        try:
            network = job.open_network()
            cameras, said = _opened(job, send)
        # Raised by CameraProcess.opened.
        except Exception as error:
            send(error)
            return
        send(Opened(cameras.rig, cameras.playback.period_s, said))
        begin: Begin = receive()
        cameras.playback.begin(begin.start_s, begin.period_s)
        _serve(cameras, network, job, receive, send)


def _opened(job: CameraJob, send: Callable[[object], None]) -> tuple[LiveCameras, tuple[str, ...]]:
    clock = Clock(job.unix_minus_monotonic_s)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", UserWarning)
        cameras = LiveCameras(job.live_rig, clock, job.late_s, send, is_known=job.is_known)
    return cameras, tuple(str(warning.message) for warning in said if issubclass(warning.category, UserWarning))


def _serve(
    cameras: LiveCameras,
    network: Network,
    job: CameraJob,
    receive: Callable[[], Any],
    send: Callable[[object], None],
) -> None:
    ended = threading.Event()

    def tell() -> None:
        while not ended.wait(STATUS_S):
            send(cameras.statuses())

    show = ShownPictures(lambda camera, picture: send(SmallPicture(camera, picture))) if job.has_viewer else None
    with cameras:
        detectors = Detectors(cameras, network, send, job.n_detectors, show)
        telling = threading.Thread(target=tell, daemon=True)
        telling.start()
        try:
            while True:
                detectors.go_on(receive())
        except EOFError:
            ended.set()
            detectors.close()
            telling.join()


class _Sender(QueueHandler):
    """Sends what is logged, ready to be pickled."""

    def __init__(self, send: Callable[[object], None]) -> None:
        super().__init__(send)  # pyright: ignore[reportArgumentType]
        self._send = send

    def enqueue(self, record: logging.LogRecord) -> None:
        self._send(record)
