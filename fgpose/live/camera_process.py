"""Some of the cameras in a process of their own: their sources, and the network that looks at their images.

Decoding and networks keep every core busy, and a library that decodes whatever comes over a network may crash: the
tracker shares neither its interpreter nor its fate with them. Pictures stay where they are decoded; what was found in
them is sent.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

from fgpose.child_process import ChildProcess
from fgpose.live.camera_messages import Begin, CameraJob, Opened
from fgpose.live.frame import CameraState, CameraStatus
from fgpose.live.rig_file import LiveRig

_LOG = logging.getLogger("fgpose.live")
_LOOKS_S = 0.2
# Without a status for so long, its cameras cannot be trusted; a process that is silent for longer hangs.
_SILENT_S, _HANGS_S = 1.0, 10.0
# Before it is started again: doubled from the first to the last, and the first again when it has worked for so long.
_FIRST_WAIT_S, _LAST_WAIT_S, _WORKS_S = 0.5, 10.0, 15.0
_SERVER = "fgpose.live.camera_server"


class CameraProcess:
    """Starts the process, hears it from a thread, and starts it again if it ends or hangs.

    Args:
        job: of the process.
        hear: takes what it sends: RecordedImage, SmallPicture and CameraEvent. It is called from the thread.

    Raises:
        OSError: the process cannot be started.
    """

    def __init__(self, job: CameraJob, hear: Callable[[Any], None]) -> None:
        self._job, self._hear = job, hear
        self._process = ChildProcess(_SERVER)
        self._process.write(job)
        self._begin: Begin | None = None
        self._statuses = _unknown(job.live_rig, "connecting")
        self._heard_s = time.monotonic()
        self._is_running = True
        self._closed = threading.Event()
        self._threads = [threading.Thread(target=run, name="cameras", daemon=True) for run in (self._run, self._watch)]

    @property
    def process_id(self) -> int:
        return self._process.process_id

    def opened(self) -> Opened:
        """Wait until its sources are open. Raises what opening them raises, and OSError if the process ends."""
        try:
            answer = self._process.read()
        except EOFError:
            self._process.close()
            raise OSError(f"the process of cameras ended with status {self._process.status}") from None
        if isinstance(answer, Exception):
            raise answer
        live_rig = replace(self._job.live_rig, rig=answer.rig)
        self._job = replace(self._job, live_rig=live_rig, is_known=True)
        return answer

    def begin(self, begin: Begin) -> None:
        """Let it read."""
        self._begin = begin
        self._process.write(begin)
        for thread in self._threads:
            thread.start()

    def go_on(self, camera_names: Sequence[str]) -> None:
        """See Detectors. One that begins anew goes on by itself."""
        with suppress(OSError):
            self._process.write(camera_names)

    def statuses(self) -> tuple[CameraStatus, ...]:
        """Of its cameras now."""
        silent_s = time.monotonic() - self._heard_s
        if self._is_running and silent_s > _SILENT_S:
            return _unknown(self._job.live_rig, f"its process does not answer for {silent_s:.0f} s", self._statuses)
        return self._statuses

    def close(self) -> None:
        """End the process. Closing again does nothing."""
        self._closed.set()
        self._process.close()
        for thread in self._threads:
            if thread.is_alive():
                thread.join()

    def _run(self) -> None:
        wait_s = _FIRST_WAIT_S
        while not self._closed.is_set():
            began_s = time.monotonic()
            try:
                while True:
                    self._take(self._process.read())
            # What is left of a process that was killed may be anything.
            except Exception as error:
                if self._closed.is_set():
                    return
                if not isinstance(error, EOFError):
                    _LOG.exception("a message of a process of cameras cannot be taken")
            wait_s = _FIRST_WAIT_S if time.monotonic() - began_s > _WORKS_S else wait_s
            self._restart(wait_s)
            wait_s = min(2 * wait_s, _LAST_WAIT_S)

    def _take(self, message: Any) -> None:
        self._heard_s = time.monotonic()
        if isinstance(message, tuple):
            self._statuses = message
        elif isinstance(message, logging.LogRecord):
            logging.getLogger(message.name).handle(message)
        elif isinstance(message, Exception):
            raise message
        elif not isinstance(message, Opened):
            self._hear(message)

    def _restart(self, wait_s: float) -> None:
        self._is_running = False
        self._process.kill()
        self._process.close()
        names = ", ".join(self._job.live_rig.rig.names)
        reason = f"its process ended with status {self._process.status} and is started again"
        _LOG.warning("camera %s: %s", names, reason)
        self._statuses = _unknown(self._job.live_rig, reason, self._statuses)
        if self._closed.wait(wait_s):
            return
        self._process = ChildProcess(_SERVER)
        self._process.write(self._job)
        self._process.write(self._begin)
        # The first status comes when the network is open, which takes seconds.
        self._heard_s = time.monotonic() + _HANGS_S
        self._is_running = True

    def _watch(self) -> None:
        while not self._closed.wait(_LOOKS_S):
            if self._is_running and time.monotonic() - self._heard_s > _HANGS_S:
                self._process.kill()


def _unknown(live_rig: LiveRig, reason: str, last: tuple[CameraStatus, ...] = ()) -> tuple[CameraStatus, ...]:
    """Cameras of which nothing is heard."""
    known = {status.name: status for status in last}
    state = CameraState.RECONNECTING
    return tuple(
        replace(known.get(name, CameraStatus(name, state)), state=state, reason=reason, rate_hz=0.0)
        for name in live_rig.rig.names
    )
