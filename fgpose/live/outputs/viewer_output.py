"""A live system in the Rerun viewer: in a window, in a file, or both."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np

from fgpose.association.track import TrackEvent
from fgpose.association.tracked import Tracked
from fgpose.geometry.camera import CameraRig
from fgpose.live.frame import CameraState, LiveFrame, LivePerson
from fgpose.live.outputs.output import BackgroundOutput
from fgpose.live.tracking import Update
from fgpose.people import Detections
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Estimate
from fgpose.viewer import open_system_recording
from fgpose.viewer.session import UpAxis
from fgpose.viewer.system_recording import CameraSaid, Moment, SystemRecording

_SILENT = (CameraState.LOST, CameraState.RECONNECTING)
# Of people who may be anywhere, ellipsoids would only hide the room.
_WIDEST_SIGMA_M = 1.0
# More changes than a viewer that hangs may miss.
_MAX_EVENTS = 200
# A viewer that hangs is dropped after half a minute; then the file is written to its end.
_CLOSE_S = 40.0


@dataclass(eq=False)
class _Seen:
    """What has come since the last moment that was shown: bounded, however slow the viewer is."""

    images: dict[str, Detections] = field(default_factory=dict)
    pictures: dict[str, np.ndarray] = field(default_factory=dict)
    events: deque[TrackEvent] = field(default_factory=lambda: deque(maxlen=_MAX_EVENTS))


class ViewerOutput(BackgroundOutput):
    """Shows frames as they are published, and what else is told. It is an Output.

    Tell it every update of the tracker (``observe``) for detections, reprojection errors and what happened to people.
    Of a viewer that is slow the newest only waits; one that is closed may come back.

    Args:
        path: the .rrd file, which appears when this is closed; None: no file.
        rig: the cameras.
        skeleton: of the people.
        live: let viewers of this computer connect, however late, at ``viewer_url``.
        port: where; 0 takes any free one.
        up: the axis of the world that points up.
        tell: see BackgroundOutput.

    Raises:
        ImportError: Rerun is not installed.
        OSError: the file cannot be written, or the port is taken.
    """

    def __init__(
        self,
        path: Path | None,
        rig: CameraRig,
        skeleton: Skeleton,
        *,
        live: bool = False,
        port: int = 0,
        up: UpAxis = "+z",
        tell: Callable[[str], None] | None = None,
    ) -> None:
        self._lock = threading.Lock()
        self._seen, self._tracked = _Seen(), dict[int, Tracked]()
        self.viewer_url: str | None = None
        """Where viewers connect."""
        self._port, numbers = port, count()

        def open_sink() -> _ViewerSink:
            # After a failure another file is begun, and viewers find what follows where they are.
            file = path if path is None else _numbered(path, next(numbers))
            recording = open_system_recording(file, rig, skeleton, live=live, port=self._port, up=up)
            self.viewer_url = recording.viewer_url
            self._port = self._port if recording.viewer_url is None else _port_of(recording.viewer_url)
            return _ViewerSink(recording, self._take)

        name = f"viewer recording {path}" if path is not None else "viewer"
        super().__init__(name, open_sink, tell=tell, close_s=_CLOSE_S)

    def observe(self, update: Update) -> None:
        """Take an update of the tracker, before its frame."""
        with self._lock:
            self._seen.images |= {image.detections.camera: image.detections for image in update.images if image.is_used}
            self._seen.events.extend(update.events)
            if any(image.is_used for image in update.images):
                self._tracked = {tracked.person: tracked for tracked in update.people}

    def show_image(self, camera: str, image_rgb: np.ndarray) -> None:
        """Show a picture of a camera, (height, width, 3) bytes RGB, perhaps scaled down. It is kept, not copied."""
        with self._lock:
            self._seen.pictures[camera] = image_rgb

    def _take(self) -> tuple[_Seen, dict[int, Tracked]]:
        with self._lock:
            seen, self._seen = self._seen, _Seen()
            return seen, self._tracked


class _ViewerSink:
    """Shows frames, with what has been seen meanwhile.

    Args:
        recording: in which they are shown.
        take: gives what has been seen since it was asked last, and the people of the newest update.
    """

    def __init__(self, recording: SystemRecording, take: Callable[[], tuple[_Seen, dict[int, Tracked]]]) -> None:
        self._recording, self._take = recording, take
        self._before: LiveFrame | None = None
        """The first that told of its images."""

    def send(self, frame: LiveFrame) -> None:
        seen, tracked = self._take()
        is_new = self._before is None or frame.time_s != self._before.time_s
        if is_new:
            self._before = frame
        assert self._before is not None
        # Without new images time goes on; not at the time of publishing, which is later than that of the next images.
        time_s = frame.time_s + frame.published_s - self._before.published_s
        moment = Moment(
            time_s=time_s,
            people=[_shown(person, frame, tracked.get(person.person), is_new) for person in frame.people],
            images=list(seen.images.values()),
            pictures=seen.pictures,
            events=list(seen.events),
            cameras={
                camera.name: CameraSaid(camera.state.value, camera.reason, camera.state in _SILENT)
                for camera in frame.cameras
            },
            delay_s=frame.age_s if is_new and any(camera.n_used for camera in frame.cameras) else None,
            observed_share=frame.observed_share,
        )
        self._recording.log_moment(moment)

    def close(self) -> None:
        self._recording.close()


def _shown(person: LivePerson, frame: LiveFrame, tracked: Tracked | None, is_new: bool) -> Tracked:
    """Somebody as published, with what the tracker says of their newest detections."""
    is_wide = np.trace(person.covariance_m2, axis1=1, axis2=2) > 3 * _WIDEST_SIGMA_M**2
    estimate = Estimate(
        skeleton=frame.skeleton,
        frame=frame.sequence,
        time_s=frame.time_s,
        positions_m=person.positions_m,
        status=person.status,
        covariance_m2=np.where(is_wide[:, None, None], np.nan, person.covariance_m2),
        residual_px=tracked.estimate.residual_px if tracked is not None and is_new else None,
    )
    return Tracked(person.person, person.state, estimate, {} if tracked is None else tracked.seen)


def _port_of(url: str) -> int:
    return urlsplit(url).port or 0


def _numbered(path: Path, number: int) -> Path:
    return path.with_name(f"{path.stem}_{number}{path.suffix}") if number else path
