"""Cameras whose images come to this process."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
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
from fgpose.live.processes.closing import Closing, all_at_once
from fgpose.live.processes.parts import Parts
from fgpose.live.processes.worker import Worker
from fgpose.live.sources import ImageSource, SourceError, open_source
from fgpose.live.sources.address import kind_of
from fgpose.live.sources.playback import Playback

_LOOKS_S = 0.2


class LiveCameras(Closing):
    """The cameras of a rig: ``with LiveCameras(load_live_rig(path), clock) as cameras`` reads them.

    All sources are opened before any is read, so that what is wrong with them is known before any work is done. A
    device or stream that cannot be opened may be switched on later: it is tried again, as one that has failed.

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
        ValueError: a recording cannot be opened, or images do not fit the calibration; one line for each recording.
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
        opened, problems = ({}, {}) if is_known else _open_all(openers, _longest_s(live_rig))
        try:
            _refuse_recordings(live_rig, problems)
            self.rig = _fitted(live_rig, opened)
            """With the intrinsics of the images that really come."""
        except ValueError:
            for source in opened.values():
                source.close()
            raise
        self.awaited = {name: error.reason for name, error in problems.items()}
        """Cameras that could not be opened, and why."""
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
        for name, reason in self.awaited.items():
            self.cameras[name].failed(reason)
        for reader in self._readers:
            reader.start()
        self._watcher.start()

    def close(self) -> None:
        """Stop reading; what hangs is left behind."""
        self._watcher.close()
        all_at_once(reader.stop for reader in self._readers)

    def __enter__(self) -> LiveCameras:
        self.start()
        return self

    def _watch(self) -> None:
        while not self._watcher.stopped.wait(_LOOKS_S):
            for reader in self._readers:
                reader.watch()


def _longest_s(live_rig: LiveRig) -> float:
    """After which opening a source hangs."""
    return HANGS * max((settings.timeout_s for settings in live_rig.sources.values()), default=0.0)


def _open_all(
    openers: Mapping[str, Callable[[], ImageSource]], longest_s: float
) -> tuple[dict[str, ImageSource], dict[str, SourceError]]:
    """All sources at once, as each may take seconds: those that are open, and what is wrong with the others. Raises
    what is not the fault of a source."""
    opening = {name: _opening(opener) for name, opener in openers.items()}
    end_s = time.monotonic() + longest_s
    opened: dict[str, ImageSource] = {}
    problems: dict[str, SourceError] = {}
    others: list[Exception] = []
    for name, source in opening.items():
        try:
            opened[name] = source.result(max(end_s - time.monotonic(), 0.0))
        except SourceError as error:
            problems[name] = error
        except TimeoutError:
            problems[name] = SourceError(name, "its source", f"opening it hangs for {longest_s:g} s")
            source.add_done_callback(_close_late)
        except Exception as error:
            others.append(error)
    if others:
        for source in opened.values():
            source.close()
        raise others[0]
    return opened, problems


def _opening(opener: Callable[[], ImageSource]) -> Future[ImageSource]:
    """A source that is opened in a thread which nobody waits for in the end."""
    source = Future[ImageSource]()

    def run() -> None:
        try:
            source.set_result(opener())
        except Exception as error:
            source.set_exception(error)

    threading.Thread(target=run, daemon=True).start()
    return source


def _close_late(source: Future[ImageSource]) -> None:
    """What is open now was given up: a device can be opened once only."""
    if source.exception() is None:
        source.result().close()


def _refuse_recordings(live_rig: LiveRig, problems: Mapping[str, SourceError]) -> None:
    """Those that cannot be opened will not be there later either. Raises ValueError with one line for each."""
    wrong = [
        str(error) for name, error in problems.items() if kind_of(live_rig.sources[name].source) in ("file", "folder")
    ]
    if wrong:
        raise ValueError("\n".join(wrong))


def _fitted(live_rig: LiveRig, opened: Mapping[str, ImageSource]) -> CameraRig:
    """The rig for the images that come. Raises ValueError where they are not the calibration's."""
    return CameraRig(
        tuple(
            fitted_camera(camera, opened[camera.name].size_px, "sources") if camera.name in opened else camera
            for camera in live_rig.rig.cameras
        )
    )
