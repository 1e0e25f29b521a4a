"""Some of the cameras in a process of their own: their sources, and the network that looks at their images.

Decoding and networks keep every core busy, and a library that decodes whatever comes over a network may crash: the
tracker shares neither its interpreter nor its fate with them. Pictures stay where they are decoded; what was found in
them is sent.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

from fgpose.child_process import ChildProcess, StoppedTwice
from fgpose.live.cameras.rig_file import LiveRig
from fgpose.live.frame import CameraState, CameraStatus
from fgpose.live.processes.camera_messages import Begin, CameraJob, Opened
from fgpose.live.processes.parts import Parts
from fgpose.live.processes.worker import HANGS_S, PartEndedError, Worker

_LOG = logging.getLogger("fgpose.live")
_LOOKS_S = 0.2
# Without a status for so long, its cameras cannot be trusted; a process that is silent for longer hangs.
_SILENT_S, _HANGS_S = 1.0, 10.0
_TAKES_WITHIN_S = 0.05
# Before it is started again: doubled from the first to the last, and the first again when it has worked for so long.
_FIRST_WAIT_S, _LAST_WAIT_S, _WORKS_S = 0.5, 10.0, 15.0
_SERVER = "fgpose.live.processes.camera_server"


class CameraProcess:
    """Starts the process, hears it from a thread, and starts it again if it ends or hangs.

    Args:
        job: of the process.
        hear: takes what it sends: RecordedImage, SmallPicture, CameraEvent and Restarts. It is called from the thread.
        parts: told when the process, or a thread that hears it, has ended.

    Raises:
        OSError: the process cannot be started.
    """

    def __init__(self, job: CameraJob, hear: Callable[[Any], None], parts: Parts | None = None) -> None:
        self._job, self._hear, self._parts = job, hear, parts or Parts()
        self._process = ChildProcess(_SERVER)
        self._process.write(job)
        self._begin: Begin | None = None
        self._statuses = _unknown(job.live_rig, "connecting")
        self._heard_s = time.monotonic()
        self._is_running = True
        self._wait_s = _FIRST_WAIT_S
        names = ", ".join(job.live_rig.rig.names)
        self._name = f"the process of {names}"
        self._reader = Worker(f"hearing the process of {names}", self._read, self._parts)
        self._watcher = Worker(f"watching the process of {names}", self._watch, self._parts, hangs_after_s=HANGS_S)

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
        self._reader.start()
        self._watcher.start()

    def go_on(self, camera_names: Sequence[str]) -> None:
        """See Detectors. One that begins anew goes on by itself."""
        process = self._process
        with suppress(BrokenPipeError):
            try:
                process.write(camera_names, _TAKES_WITHIN_S)
            # Many of these fit into a pipe: it has not read any for long.
            except TimeoutError:
                process.kill()

    def statuses(self) -> tuple[CameraStatus, ...]:
        """Of its cameras now."""
        silent_s = time.monotonic() - self._heard_s
        if self._is_running and silent_s > _SILENT_S:
            return _unknown(self._job.live_rig, f"its process does not answer for {silent_s:.0f} s", self._statuses)
        return self._statuses

    def close(self) -> None:
        """End the process. Closing again does nothing."""
        self._reader.stopped.set()
        self._watcher.stopped.set()
        self._process.close()
        self._reader.close()
        self._watcher.close()
        # The reader may have started another one meanwhile.
        self._process.close()

    def _read(self) -> None:
        """Hear the process, and the next one when it has ended."""
        while not self._reader.stopped.is_set():
            began_s, reason = time.monotonic(), ""
            try:
                while True:
                    self._take(self._process.read())
            # What is left of a process that was killed may be anything.
            except Exception as error:
                if self._reader.stopped.is_set():
                    return
                if isinstance(error, PartEndedError):
                    reason = str(error)
                elif not isinstance(error, EOFError):
                    _LOG.exception("a message of a process of cameras cannot be taken")
            self._wait_s = _FIRST_WAIT_S if time.monotonic() - began_s > _WORKS_S else self._wait_s
            self._restart(reason)
            self._wait_s = min(2 * self._wait_s, _LAST_WAIT_S)

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

    def _restart(self, reason: str) -> None:
        self._is_running = False
        self._process.kill()
        self._process.close()
        reason = reason or f"status {self._process.status}"
        self._parts.restarted(self._name, reason)
        said = f"its process ended ({reason}) and is started again"
        self._statuses = _unknown(self._job.live_rig, said, self._statuses)
        if self._reader.stopped.wait(self._wait_s):
            return
        process = ChildProcess(_SERVER)
        process.write(self._job)
        process.write(self._begin)
        self._process = process
        # The first status comes when the network is open, which takes seconds.
        self._heard_s = time.monotonic() + _HANGS_S
        self._is_running = True

    def _watch(self) -> None:
        """Kill it if it hangs; that is heard."""
        looks = StoppedTwice()
        while not self._watcher.stopped.wait(_LOOKS_S):
            hangs = self._is_running and time.monotonic() - self._heard_s > _HANGS_S
            if looks.again(self._is_running and self._process.is_stopped) or hangs:
                self._process.kill()


def _unknown(live_rig: LiveRig, reason: str, last: tuple[CameraStatus, ...] = ()) -> tuple[CameraStatus, ...]:
    """Cameras of which nothing is heard."""
    known = {status.name: status for status in last}
    state = CameraState.RECONNECTING
    return tuple(
        replace(known.get(name, CameraStatus(name, state)), state=state, reason=reason, rate_hz=0.0)
        for name in live_rig.rig.names
    )
