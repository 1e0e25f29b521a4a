"""Cameras whose images come to this process."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from functools import partial

from fgpose.config import OnlineConfig
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.fitted_camera import fitted_camera
from fgpose.live.cameras.camera import CameraEvent, LiveCamera
from fgpose.live.cameras.image import Image
from fgpose.live.cameras.mailbox import Mailbox
from fgpose.live.cameras.reader import HANGS, CameraReader
from fgpose.live.cameras.rig_file import LiveRig
from fgpose.live.clock import Clock
from fgpose.live.frame import CameraStatus
from fgpose.live.processes.parts import Parts
from fgpose.live.processes.worker import Worker
from fgpose.live.sources import ImageSource, SourceError, open_source
from fgpose.live.sources.playback import Playback

_LOOKS_S = 0.2


class LiveCameras:
    """The cameras of a rig: ``with LiveCameras(load_live_rig(path), clock) as cameras`` reads them.

    All sources are opened before any is read, so that what is wrong with them is known before any work is done.

    Args:
        live_rig: cameras and sources, none of which is ``zmq``.
        clock: of the live system.
        late_s: images that arrive this long after they were taken are late; default: the lag of the estimator.
        on_event: called once for every change of a camera's state, in any thread.
        parts: told when a thread has ended.
        is_known: the sources were open before. They are opened again when they can be, and the calibration is that of
            their images.

    Warns:
        UserWarning: the size of the images differs from the calibration's in a way that can be explained.

    Raises:
        ValueError: a source cannot be opened or its images do not fit the calibration; one line for each.
        ImportError: a library is not installed.
    """

    def __init__(
        self,
        live_rig: LiveRig,
        clock: Clock,
        late_s: float = OnlineConfig.lag_s,
        on_event: Callable[[CameraEvent], None] | None = None,
        *,
        parts: Parts | None = None,
        is_known: bool = False,
    ) -> None:
        self.changed = threading.Condition()
        """Notified for every new image."""
        self.cameras = {
            name: LiveCamera(name, settings, clock, late_s, on_event) for name, settings in live_rig.sources.items()
        }
        self.mailboxes = {name: Mailbox[Image](self.changed) for name in self.cameras}
        """The newest image of each camera."""
        self.playback = Playback(clock)
        """Of the recordings among the sources."""
        self._clock = clock
        openers = {
            name: partial(open_source, name, settings, clock, self.playback)
            for name, settings in live_rig.sources.items()
        }
        opened = {} if is_known else _open_all(openers, _longest_s(live_rig))
        try:
            self.rig = _fitted(live_rig, opened)
            """With the intrinsics of the images that really come."""
        except ValueError:
            for source in opened.values():
                source.close()
            raise
        size_px = {camera.name: camera.size_px for camera in self.rig.cameras}
        self._readers = [
            CameraReader(camera, self.mailboxes[name], openers[name], size_px[name], opened.get(name), parts)
            for name, camera in self.cameras.items()
        ]
        self._watcher = Worker(f"watching {', '.join(self.cameras)}", self._watch, parts)

    def __getitem__(self, name: str) -> LiveCamera:
        return self.cameras[name]

    def statuses(self) -> tuple[CameraStatus, ...]:
        """Of all cameras now, in the order of the rig."""
        return tuple(camera.status(self._clock.now_s()) for camera in self.cameras.values())

    def start(self) -> None:
        """Read from now on."""
        for reader in self._readers:
            reader.start()
        self._watcher.start()

    def close(self) -> None:
        """Stop reading; what hangs is left behind."""
        self._watcher.close()
        stops = [threading.Thread(target=reader.stop) for reader in self._readers]
        for stop in stops:
            stop.start()
        for stop in stops:
            stop.join()

    def __enter__(self) -> LiveCameras:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _watch(self) -> None:
        while not self._watcher.stopped.wait(_LOOKS_S):
            for reader in self._readers:
                reader.watch()


def _longest_s(live_rig: LiveRig) -> float:
    """After which opening a source hangs."""
    return HANGS * max((settings.timeout_s for settings in live_rig.sources.values()), default=0.0)


def _open_all(openers: Mapping[str, Callable[[], ImageSource]], longest_s: float) -> dict[str, ImageSource]:
    """All sources at once, as each may take seconds. Raises ValueError with the problems of all."""
    end_s = time.monotonic() + longest_s
    opened: dict[str, ImageSource] = {}
    problems: dict[str, Exception] = {}

    def open_one(name: str) -> None:
        try:
            opened[name] = openers[name]()
        except Exception as error:
            problems[name] = error

    threads = [threading.Thread(target=open_one, args=(name,), daemon=True) for name in openers]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(max(end_s - time.monotonic(), 0.0))
    for name in openers:
        if name not in opened and name not in problems:
            problems[name] = SourceError(name, "its source", f"opening it hangs for {longest_s:g} s")
    if not problems:
        return {name: opened[name] for name in openers}
    for source in opened.values():
        source.close()
    for error in problems.values():
        if not isinstance(error, SourceError):
            raise error
    raise ValueError("\n".join(str(problems[name]) for name in openers if name in problems))


def _fitted(live_rig: LiveRig, opened: Mapping[str, ImageSource]) -> CameraRig:
    """The rig for the images that come. Raises ValueError where they are not the calibration's."""
    return CameraRig(
        tuple(
            fitted_camera(camera, opened[camera.name].size_px, "sources") if camera.name in opened else camera
            for camera in live_rig.rig.cameras
        )
    )
