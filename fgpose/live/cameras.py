"""All cameras of a live system."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from functools import partial

from fgpose.config import OnlineConfig
from fgpose.geometry.camera import CameraRig
from fgpose.live.camera import CameraEvent, LiveCamera
from fgpose.live.clock import Clock
from fgpose.live.frame import CameraStatus
from fgpose.live.image import Image
from fgpose.live.mailbox import Mailbox
from fgpose.live.reader import HANGS, CameraReader
from fgpose.live.rig_file import LiveRig
from fgpose.live.sources import Source, SourceError, open_source
from fgpose.live.sources.playback import Playback
from fgpose.monocular.sources import fitted_camera

_LOOKS_S = 0.2


class LiveCameras:
    """The cameras of a rig, read from now on: ``with LiveCameras(load_live_rig(path), clock) as cameras``.

    All sources are opened before any is read, so that what is wrong with them is known before any work is done. Cameras
    whose source is ``zmq`` have no reader: whoever gets their messages calls ``cameras[name].receive``.

    Args:
        live_rig: cameras and sources.
        clock: of the live system.
        late_s: images that arrive this long after they were taken are late; default: the lag of the estimator.
        on_event: called once for every change of a camera's state, in any thread.

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
    ) -> None:
        self.changed = threading.Condition()
        """Notified for every new image."""
        self.cameras = {
            name: LiveCamera(name, settings, clock, late_s, Mailbox[Image](self.changed), on_event)
            for name, settings in live_rig.sources.items()
        }
        self._clock, self._stopped = clock, threading.Event()
        playback = Playback(clock)
        openers = {
            name: partial(open_source, name, settings, clock, playback)
            for name, settings in live_rig.sources.items()
            if settings.source != "zmq"
        }
        longest_s = HANGS * max((settings.timeout_s for settings in live_rig.sources.values()), default=0.0)
        opened = _open_all(openers, longest_s)
        try:
            self.rig = _fitted(live_rig, opened)
            """With the intrinsics of the images that really come."""
        except ValueError:
            for source in opened.values():
                source.close()
            raise
        self._readers = [
            CameraReader(self.cameras[name], openers[name], source.size_px, source) for name, source in opened.items()
        ]
        for reader in self._readers:
            reader.start()
        self._watcher = threading.Thread(target=self._watch, name="cameras", daemon=True)
        self._watcher.start()

    def __getitem__(self, name: str) -> LiveCamera:
        return self.cameras[name]

    def statuses(self) -> tuple[CameraStatus, ...]:
        """Of all cameras now, in the order of the rig."""
        return tuple(camera.status(self._clock.now_s()) for camera in self.cameras.values())

    def take_newest(self) -> list[Image]:
        """The newest images that nobody has taken, at most one of each camera, the oldest first."""
        taken = (camera.mailbox.take() for camera in self.cameras.values())
        return sorted((image for image in taken if image is not None), key=lambda image: image.captured_s)

    def wait(self, timeout_s: float) -> bool:
        """Until there is an image; False if none came within this time."""
        with self.changed:
            return self.changed.wait_for(self._has_image, timeout_s)

    def close(self) -> None:
        """Stop reading; what hangs is left behind."""
        self._stopped.set()
        stops = [threading.Thread(target=reader.stop) for reader in self._readers]
        for stop in stops:
            stop.start()
        for stop in stops:
            stop.join()

    def __enter__(self) -> LiveCameras:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _has_image(self) -> bool:
        return any(camera.mailbox.peek() is not None for camera in self.cameras.values())

    def _watch(self) -> None:
        received = [camera for camera in self.cameras.values() if camera.settings.source == "zmq"]
        while not self._stopped.wait(_LOOKS_S):
            for reader in self._readers:
                reader.watch()
            for camera in received:
                camera.look()


def _open_all(openers: Mapping[str, Callable[[], Source]], longest_s: float) -> dict[str, Source]:
    """All sources at once, as each may take seconds. Raises ValueError with the problems of all."""
    end_s = time.monotonic() + longest_s
    opened: dict[str, Source] = {}
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


def _fitted(live_rig: LiveRig, opened: Mapping[str, Source]) -> CameraRig:
    """The rig for the images that come. Raises ValueError where they are not the calibration's."""
    return CameraRig(
        tuple(
            fitted_camera(camera, opened[camera.name].size_px, "its source") if camera.name in opened else camera
            for camera in live_rig.rig.cameras
        )
    )
