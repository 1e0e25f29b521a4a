"""A recording of a live system on disk that is complete, but for the last moment, whatever ends the process."""

from __future__ import annotations

import contextlib
import errno
import math
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from fgpose.config import Config
from fgpose.geometry.camera import CameraRig
from fgpose.io.live.packing import packed
from fgpose.io.live.record_files import MAGIC, as_record
from fgpose.io.live.recordings import RecordedImage, images_document, start_document
from fgpose.live.frame import LiveFrame
from fgpose.live.outputs.frame_messages import frame_document
from fgpose.live.outputs.output import OutputState
from fgpose.live.processes.closing import Closing
from fgpose.live.processes.parts import Parts
from fgpose.live.processes.worker import HANGS_S, Worker
from fgpose.skeleton import Skeleton

# Records that may wait for the disk: ten seconds of four cameras at 30 Hz. Beyond that the newest are left out.
_MAX_WAITING = 2000
_FIRST_RETRY_S, _LONGEST_RETRY_S = 0.5, 5.0
_CLOSE_S = 5.0
# That it does not hang, it shows so often.
_SHOWS_S = 0.5
# Of these, the last may make room for the end of a recording on a disk that is full.
_MAX_CUT = 8
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
# What the operating system holds is brought to the disk so often: a power cut costs no more.
_SYNCED_EVERY_S = 1.0


class Recorder(Closing):
    """Writes what the tracker is given and what is published, record by record, from a thread of its own.

    Every record is with the operating system as soon as it is written, so that a kill costs only those that wait: none
    if the disk keeps up. A disk that is full or fails is tried again; what cannot wait any longer is left out and
    counted, and the recording says how much, also where the disk is still full at its end: then its last records are
    replaced by that. It is an Output, and all its methods may be called from any thread.

    Args:
        path: of the file; the folder must exist.
        rig: the cameras.
        skeleton: of the people.
        config: what the tracker is run with.
        now_s: Unix time.
        tell: called with one line when writing fails, and when it works again.
        parts: told when the thread has ended.

    Raises:
        FileExistsError: the file is there already.
        OSError: it cannot be written.
        ImportError: MessagePack is not installed.
    """

    def __init__(
        self,
        path: str | Path,
        rig: CameraRig,
        skeleton: Skeleton,
        config: Config | None = None,
        *,
        now_s: Callable[[], float] = time.time,
        tell: Callable[[str], None] | None = None,
        parts: Parts | None = None,
    ) -> None:
        self._path, self._tell = Path(path), tell
        start = start_document(rig, skeleton, config or Config(), now_s())
        self._file = self._path.open("xb", buffering=0)
        self._file.write(MAGIC)
        self._n_bytes, self._is_torn, self._synced_s = len(MAGIC), False, -math.inf
        self._append(start)
        self._changed = threading.Condition()
        self._waiting: deque[dict[str, Any]] = deque()
        self._n_lost = 0
        """Records left out that the file does not yet mention."""
        self._n_ever_lost = 0
        self._n_frames = self._n_skipped = 0
        self._written: deque[tuple[int, bool]] = deque(maxlen=_MAX_CUT)
        """Where the last records begin, and whether they are frames."""
        self._is_failing, self._last_error, self._is_closed = False, "", False
        self._worker = Worker("the recorder", self._run, parts, hangs_after_s=HANGS_S)
        self._worker.start()

    def record(self, images: Sequence[RecordedImage]) -> None:
        """Record images that are given to the tracker together, or that are not to be used."""
        self._put(images_document(list(images)))

    def publish(self, frame: LiveFrame) -> None:
        self._put({"kind": "frame", **frame_document(frame)})

    @property
    def state(self) -> OutputState:
        name = f"recording {self._path}"
        counts = self._n_frames, self._n_skipped
        return OutputState(name, not self._is_failing, *counts, self._last_error, self._n_ever_lost, is_file=True)

    def close(self) -> None:
        """Write what waits and end the recording; closing again does nothing."""
        with self._changed:
            self._is_closed = True
            self._changed.notify()
        self._worker.close(_CLOSE_S)
        if self._worker.is_alive:
            self._failed(TimeoutError(f"the disk has not taken the rest within {_CLOSE_S:.0f} s"))
            with self._changed:
                self._n_ever_lost += len(self._waiting)

    def _put(self, document: dict[str, Any]) -> None:
        with self._changed:
            if self._is_closed:
                return
            if len(self._waiting) >= _MAX_WAITING:
                self._leave_out(document)
                return
            self._waiting.append(document)
            self._changed.notify()

    def _leave_out(self, document: dict[str, Any]) -> None:
        self._count_lost(document["kind"] == "frame")

    def _leave_out_all(self) -> None:
        with self._changed:
            while self._waiting:
                self._leave_out(self._waiting.popleft())

    def _count_lost(self, is_frame: bool) -> None:
        self._n_lost += 1
        self._n_ever_lost += 1
        self._n_skipped += is_frame

    def _run(self) -> None:
        retry_s = _FIRST_RETRY_S
        while self._is_waiting():
            try:
                self._write_oldest()
                self._sync()
            except OSError as error:
                self._failed(error)
                if self._pause(retry_s):
                    break
                retry_s = min(2 * retry_s, _LONGEST_RETRY_S)
            else:
                retry_s = _FIRST_RETRY_S
        self._leave_out_all()
        while self._is_too_full_to_end() and self._written:
            self._cut_last()
        with contextlib.suppress(OSError):
            self._file.close()

    def _is_waiting(self) -> bool:
        """Whether there is something to write, when there is; no: the recording is to end, and all is written."""
        is_asked = self._worker.stopped
        with self._changed:
            while not (self._waiting or self._is_closed):
                is_asked.is_set()  # to show that it waits, and does not hang
                self._changed.wait(_SHOWS_S)
            is_asked.is_set()
            return bool(self._waiting)

    def _write_oldest(self) -> None:
        """Write a record, and how many are missing. It is taken away when it is written."""
        with self._changed:
            document = self._waiting[0]
        start = self._n_bytes
        try:
            self._append(document)
        except OSError:
            raise
        # Whatever is wrong with one record: it must not keep the others from the file.
        except Exception as error:
            self._last_error = f"a record that cannot be written: {type(error).__name__}: {error}"
            with self._changed:
                self._waiting.popleft()
                self._leave_out(document)
            return
        with self._changed:
            self._waiting.popleft()
            self._written.append((start, document["kind"] == "frame"))
            self._n_frames += document["kind"] == "frame"
            n_lost = self._n_lost if len(self._waiting) < _MAX_WAITING // 2 else 0
        if n_lost:
            self._append(_lost(n_lost))
            self._written.clear()  # what is said to be lost must not be cut off
            with self._changed:
                self._n_lost -= n_lost
        if self._is_failing:
            self._is_failing = False
            self._say(f"the recording {self._path} goes on")

    def _is_too_full_to_end(self) -> bool:
        """Write the end, and what is missing, both or nothing."""
        try:
            self._append(*([_lost(self._n_lost)] if self._n_lost else []), {"kind": "end"})
        except OSError as error:
            self._failed(error)
            return error.errno in _FULL
        return False

    def _cut_last(self) -> None:
        """Of what is written, so that the end can be."""
        self._n_bytes, is_frame = self._written.pop()
        with self._changed:
            self._n_frames -= is_frame
            self._count_lost(is_frame)

    def _sync(self) -> None:
        """Bring what is written to the disk, where that was long ago."""
        if time.monotonic() > self._synced_s + _SYNCED_EVERY_S:
            self._synced_s = time.monotonic()
            os.fsync(self._file.fileno())

    def _append(self, *documents: dict[str, Any]) -> None:
        """Write records, all or none. What a full disk has taken of others before is cut off first."""
        records = b"".join(as_record(packed(document)) for document in documents)
        if self._is_torn:
            os.ftruncate(self._file.fileno(), self._n_bytes)
            self._file.seek(self._n_bytes)
        self._is_torn = True
        left = memoryview(records)
        while left:
            left = left[self._file.write(left) :]
        self._n_bytes += len(records)
        self._is_torn = False

    def _failed(self, error: Exception) -> None:
        self._last_error = f"{type(error).__name__}: {error}"
        if not self._is_failing:
            self._say(f"the recording {self._path} cannot be written ({self._last_error}); it is tried again")
        self._is_failing = True

    def _say(self, line: str) -> None:
        if self._tell is not None:
            self._tell(line)

    def _pause(self, duration_s: float) -> bool:
        """Whether the recording is ended meanwhile."""
        end_s = time.monotonic() + duration_s
        with self._changed:
            while not self._is_closed and (left_s := end_s - time.monotonic()) > 0:
                self._worker.stopped.is_set()
                self._changed.wait(min(left_s, _SHOWS_S))
            return self._is_closed


def _lost(n_records: int) -> dict[str, Any]:
    return {"kind": "lost", "n": n_records}
