"""All cameras of a live system: those with images in processes, those whose keypoints come from elsewhere here."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from fgpose.child_process import n_cores
from fgpose.config import OnlineConfig
from fgpose.geometry.camera import CameraRig
from fgpose.io.live.recordings import RecordedImage
from fgpose.live.cameras.camera import CameraEvent, LiveCamera
from fgpose.live.cameras.rig_file import LiveRig
from fgpose.live.clock import Clock
from fgpose.live.frame import CameraStatus, Restarts
from fgpose.live.processes.camera_messages import Begin, CameraJob, Opened, SmallPicture
from fgpose.live.processes.camera_process import CameraProcess
from fgpose.live.processes.closing import Closing, all_at_once
from fgpose.live.processes.parts import Parts
from fgpose.live.processes.pending_detections import PendingDetections
from fgpose.monocular.network import Network

_LOG = logging.getLogger("fgpose.live")
ELSEWHERE = "zmq"
"""The source of cameras whose keypoints are received."""


class CameraFeed(Closing):
    """The cameras of a rig, read from now on, and what networks find in their images. It is a Feed.

    All sources are opened before any is read, so that what is wrong with them is known before any work is done. A
    device or stream that cannot be opened is tried again, see LiveCameras.

    Args:
        live_rig: cameras and sources.
        clock: of the live system.
        open_network: opens the network that looks for people, in each process; it can be pickled, as a function of a
            module or functools.partial of one. None where all detectors are elsewhere.
        late_s: images that arrive this long after they were taken are late; default: the lag of the estimator.
        n_jobs: images at which networks look at once, None: one for each core.
        on_event: called once for every change of a camera's state, in any thread.
        show: takes the name of a camera, its picture, (H, W, 3) RGB, scaled down, and the Unix time at which it was
            taken, a few times a second, in any thread.
        parts: told when a process, or a thread of one, has ended.

    Warns:
        UserWarning: the size of the images differs from the calibration's in a way that can be explained.

    Raises:
        ValueError: a recording cannot be opened or images do not fit the calibration, with one line for each; or there
            is no network for images.
        ImportError: a library is not installed.
        OSError: a process cannot be started, or ends at once.
    """

    def __init__(
        self,
        live_rig: LiveRig,
        clock: Clock,
        open_network: Callable[[], Network] | None = None,
        late_s: float = OnlineConfig.lag_s,
        n_jobs: int | None = None,
        on_event: Callable[[CameraEvent], None] | None = None,
        show: Callable[[str, np.ndarray, float], None] | None = None,
        parts: Parts | None = None,
    ) -> None:
        self._clock, self._on_event, self._show, self._parts = clock, on_event, show, parts or Parts(clock.now_s)
        sources = live_rig.sources
        self.received = {
            name: LiveCamera(name, settings, clock, late_s, on_event)
            for name, settings in sources.items()
            if settings.source == ELSEWHERE
        }
        """Cameras whose keypoints come from elsewhere: whoever gets them calls receive, and then deliver."""
        self._arrivals = PendingDetections(live_rig.rig.names)
        shares = _shares(live_rig, n_jobs or n_cores())
        if shares and open_network is None:
            raise ValueError(f"a network is needed for the images of {', '.join(shares[0].rig.names)}")
        self._names = [share.rig.names for share in shares]
        self._processes: list[CameraProcess] = []
        try:
            for share in shares:
                assert open_network is not None
                n_detectors = max((n_jobs or n_cores()) // len(shares), 1)
                job = CameraJob(
                    share, open_network, late_s, n_detectors, clock.unix_minus_monotonic_s, show is not None
                )
                self._processes.append(CameraProcess(job, self._hear, self._parts))
            opened = _opened(self._processes)
        except BaseException:
            self.close()
            raise
        self.rig = _joined(live_rig.rig, [each.rig for each in opened])
        """With the intrinsics of the images that really come."""
        if len(self.rig.names) == sum(len(each.awaited) for each in opened):
            _LOG.warning("no camera can be opened: waiting for them")
        begin = Begin(clock.now_s(), max((each.period_s for each in opened), default=0.0))
        for process in self._processes:
            process.begin(begin)

    @property
    def process_ids(self) -> tuple[int, ...]:
        """Of the processes of cameras."""
        return tuple(process.process_id for process in self._processes)

    def take(self, timeout_s: float) -> list[RecordedImage]:
        """See Feed."""
        return self._arrivals.take(timeout_s)

    def statuses(self) -> tuple[CameraStatus, ...]:
        """See Feed."""
        now_s = self._clock.now_s()
        known = {status.name: status for process in self._processes for status in process.statuses()}
        known |= {name: camera.status(now_s) for name, camera in self.received.items()}
        return tuple(
            replace(known[name], n_lost=known[name].n_lost + self._arrivals.n_left_out(name)) for name in self.rig.names
        )

    def go_on(self, camera_names: Collection[str]) -> None:
        """See Feed."""
        for process, names in zip(self._processes, self._names, strict=True):
            own = [name for name in names if name in camera_names]
            if own:
                process.go_on(own)

    def deliver(self, image: RecordedImage) -> None:
        """Add detections that came from elsewhere, from any thread."""
        self._arrivals.put(image)

    def close(self) -> None:
        """End the processes. Closing again does nothing."""
        all_at_once(process.close for process in self._processes)

    def _hear(self, message: Any) -> None:
        if isinstance(message, RecordedImage):
            self._arrivals.put(message)
        elif isinstance(message, SmallPicture) and self._show is not None:
            self._show(message.camera, message.picture_rgb, message.time_s)
        elif isinstance(message, CameraEvent) and self._on_event is not None:
            self._on_event(message)
        elif isinstance(message, Restarts):
            self._parts.heard(message)


def _shares(live_rig: LiveRig, n_processes: int) -> list[LiveRig]:
    """The cameras with images, dealt out to processes. Recordings that are played as fast as possible stay in step by
    waiting for each other: they are read by the first."""
    names = [name for name, settings in live_rig.sources.items() if settings.source != ELSEWHERE]
    fast = [name for name in names if live_rig.sources[name].pace == "fast"]
    others = [name for name in names if name not in fast]
    dealt = [list[str]() for _ in range(n_processes)]
    dealt[0] += fast
    for name in others:
        min(dealt, key=len).append(name)
    return [
        LiveRig(live_rig.rig.subset(share), {name: live_rig.sources[name] for name in share})
        for share in dealt
        if share
    ]


def _opened(processes: Sequence[CameraProcess]) -> list[Opened]:
    """What all have opened. Raises ValueError with the problems of all."""
    opened, problems = list[Opened](), list[str]()
    for process in processes:
        try:
            opened.append(process.opened())
        except ValueError as error:
            problems.append(str(error))
    if problems:
        raise ValueError("\n".join(problems))
    for warning in (warning for each in opened for warning in each.warnings):
        warnings.warn(warning, stacklevel=4)
    return opened


def _joined(rig: CameraRig, parts: Sequence[CameraRig]) -> CameraRig:
    fitted: Mapping[str, Any] = {camera.name: camera for part in parts for camera in part.cameras}
    return CameraRig(tuple(fitted.get(camera.name, camera) for camera in rig.cameras))
