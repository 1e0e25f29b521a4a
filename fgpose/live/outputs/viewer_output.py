"""A live system in the Rerun viewer: in a window, in a file, or both."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np

from fgpose.association.track import TrackEvent
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.up_axis import UpAxis
from fgpose.live.frame import LiveFrame
from fgpose.live.outputs.output import BackgroundOutput
from fgpose.live.outputs.viewer_process import (
    FrameToShow,
    PictureToShow,
    TrackedDetections,
    ViewerJob,
    ViewerProcess,
)
from fgpose.live.pictures_with_people import PicturesWithPeople
from fgpose.live.processes.parts import Parts
from fgpose.live.tracking.live_tracking import Update
from fgpose.people_observations import Detections
from fgpose.skeleton import Skeleton

# More changes than a viewer that hangs may miss.
_MAX_EVENTS = 200
# A viewer that hangs is dropped after half a minute; then the file is written to its end.
_CLOSE_S = 40.0
# Images of a camera among which that of a picture is looked for: more than come while its people are waited for.
_N_USED = 100


@dataclass(eq=False)
class _Seen:
    """What has come since the last moment that was shown: bounded, however slow the viewer is."""

    images: dict[str, Detections] = field(default_factory=dict)
    pictures: dict[str, PictureToShow] = field(default_factory=dict)
    events: deque[TrackEvent] = field(default_factory=lambda: deque(maxlen=_MAX_EVENTS))


@dataclass(frozen=True, eq=False)
class _Used:
    """An image that was used, and whose its detections are, by person as of Tracked."""

    detections: Detections
    seen: Mapping[int, Mapping[str, tuple[np.ndarray, np.ndarray]]]


class ViewerOutput(BackgroundOutput):
    """Shows frames as they are published, and what else is told. It is an Output.

    Tell it every update of the tracker (``observe``) for detections, reprojection errors and what happened to people.
    A process of its own shows them. Of a viewer that is slow the newest only waits; one that is closed may come back.

    Args:
        path: the .rrd file, which appears when this is closed; None: no file.
        rig: the cameras.
        skeleton: of the people.
        live: let viewers of this computer connect, however late, at ``viewer_url``.
        port: where; 0 takes any free one.
        up: the axis of the world that points up.
        tell, parts: see BackgroundOutput.

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
        parts: Parts | None = None,
    ) -> None:
        self._lock = threading.Lock()
        self._seen, self._sightings = _Seen(), dict[int, TrackedDetections]()
        self._pictures = PicturesWithPeople(rig)
        self._used = {name: deque[_Used](maxlen=_N_USED) for name in rig.names}
        self.viewer_url: str | None = None
        """Where viewers connect."""
        self._port, numbers = port, count()

        def open_sink() -> _ViewerSink:
            # After a failure another file is begun, and viewers find what follows where they are.
            file = path if path is None else _numbered(path, next(numbers))
            process = ViewerProcess(ViewerJob(file, rig, skeleton, live, self._port, up))
            self.viewer_url = process.viewer_url
            self._port = self._port if process.viewer_url is None else urlsplit(process.viewer_url).port or 0
            return _ViewerSink(process, self._shown) if file is None else _ViewerFileSink(process, self._shown)

        name = f"viewer recording {path}" if path is not None else "viewer"
        super().__init__(name, open_sink, tell=tell, parts=parts, close_s=_CLOSE_S)

    def observe(self, update: Update) -> None:
        """Take an update of the tracker, before its frame."""
        with self._lock:
            self._seen.images |= {image.detections.camera: image.detections for image in update.images if image.is_used}
            self._seen.events.extend(update.events)
            seen = {tracked.person: tracked.seen for tracked in update.people}
            for image in update.images:
                if image.is_used:
                    self._used[image.detections.camera].append(_Used(image.detections, seen))
            if any(image.is_used for image in update.images):
                self._sightings = {
                    tracked.person: TrackedDetections(tracked.estimate.residual_px, tracked.seen)
                    for tracked in update.people
                }

    def show_image(self, camera: str, image_rgb: np.ndarray, time_s: float) -> None:
        """Show a picture of a camera, (height, width, 3) bytes RGB, perhaps scaled down, that was taken at this Unix
        time. It is kept, not copied, and shown as soon as the poses of its moment are known."""
        self._pictures.add_picture(camera, image_rgb, time_s)

    def publish(self, frame: LiveFrame) -> None:
        """See Output."""
        self._pictures.add_frame(frame)
        with self._lock:
            for camera, picture in self._pictures.take().items():
                used = [each for each in self._used[camera] if each.detections.time_s == picture.time_s]
                found = (used[-1].detections, used[-1].seen) if used else (None, {})
                self._seen.pictures[camera] = PictureToShow(picture, *found)
        super().publish(frame)

    def _shown(self, frame: LiveFrame) -> FrameToShow:
        with self._lock:
            seen, self._seen = self._seen, _Seen()
            return FrameToShow(frame, self._sightings, list(seen.images.values()), seen.pictures, list(seen.events))


class _ViewerSink:
    """Shows frames, with what has been seen meanwhile.

    Args:
        process: that shows them.
        shown: a frame with what has been seen since it was asked last.
    """

    def __init__(self, process: ViewerProcess, shown: Callable[[LiveFrame], FrameToShow]) -> None:
        self._process, self._shown = process, shown

    def send(self, frame: LiveFrame) -> None:
        self._process.send(self._shown(frame))

    def close(self) -> None:
        self._process.close()


class _ViewerFileSink(_ViewerSink):
    """The same, of a file."""

    def __init__(self, process: ViewerProcess, shown: Callable[[LiveFrame], FrameToShow]) -> None:
        super().__init__(process, shown)
        self._note = ""

    @property
    def n_held(self) -> int:
        return self._process.n_held

    def note_lost(self, n_frames: int) -> None:
        """With the next frame."""
        self._note = f"{n_frames} frames before are missing"

    def send(self, frame: LiveFrame) -> None:
        note, self._note = self._note, ""
        self._process.send(replace(self._shown(frame), note=note))


def _numbered(path: Path, number: int) -> Path:
    return path.with_name(f"{path.stem}_{number}{path.suffix}") if number else path
