"""The file from which the next live system goes on."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from fgpose.config import Config
from fgpose.geometry.camera import CameraRig
from fgpose.io.atomic import check_replaceable
from fgpose.io.live.tracker_memory import TrackerMemory, save_memory
from fgpose.live.processes.parts import Parts
from fgpose.live.processes.worker import Worker
from fgpose.live.tracking.live_tracking import LiveTracking

# What is lost if the computer fails. To gather it takes a millisecond.
_EVERY_S = 10.0
_LOOKS_S = 0.2


class MemoryFile:
    """Writes what a tracker knows, every ten seconds in a thread of its own, and when it is closed.

    Args:
        path: of the file, which is replaced.
        tracking: whose memory it is; not closed before this is.
        rig, config: by which the file is known to fit, as of load_memory.
        tell: called with one line when it cannot be written, and when it can again.
        parts: told when the thread has ended.

    Raises:
        OSError: the file cannot be replaced; the message names it.
    """

    def __init__(
        self,
        path: Path,
        tracking: LiveTracking,
        rig: CameraRig,
        config: Config,
        tell: Callable[[str], None] = lambda line: None,
        parts: Parts | None = None,
    ) -> None:
        check_replaceable(path)
        self._path, self._tracking, self._made_for, self._tell = path, tracking, (rig, tracking.skeleton, config), tell
        self._newest: TrackerMemory | None = None
        self._due_s, self._is_failing = time.monotonic() + _EVERY_S, False
        self._worker = Worker("writing what the next system goes on from", self._run, parts)
        self._worker.start()

    def observe(self, _: object) -> None:
        """Gather it, if it is time to; in the thread that tracks."""
        if time.monotonic() >= self._due_s:
            self._due_s = time.monotonic() + _EVERY_S
            self._newest = self._tracking.memory()

    def close(self) -> None:
        """Write it as it is now, when nothing is tracked any more. Closing again does nothing."""
        self._worker.close()
        self._newest = self._tracking.memory()
        self._write()

    def _run(self) -> None:
        while not self._worker.stopped.wait(_LOOKS_S):
            self._write()

    def _write(self) -> None:
        memory, self._newest = self._newest, None
        if memory is None:
            return
        try:
            save_memory(memory, self._path, *self._made_for)
            said = ""
        except OSError as error:
            said = f"the next live system cannot go on from this one: {error}"
        if bool(said) != self._is_failing:
            self._tell(said or f"{self._path} is written again")
        self._is_failing = bool(said)
