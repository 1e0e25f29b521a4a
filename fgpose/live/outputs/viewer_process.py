"""A live system as the Rerun viewer shows it, in a process of its own.

So the tracker has the interpreter for itself, and the file is written to its end whatever happens to the tracker.
"""

from __future__ import annotations

import math
import pickle
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from fgpose.association.track import Tracked, TrackEvent
from fgpose.child_process import ChildProcess, parent
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.up_axis import UpAxis
from fgpose.live.diagnosis.told_live import changes
from fgpose.live.frame import CameraState, LiveFrame, LiveJudgement, LivePerson
from fgpose.live.pictures_with_people import PictureWithPeople
from fgpose.live.processes.priority import give_way
from fgpose.people_observations import Detections
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Estimate
from fgpose.viewer import open_system_recording
from fgpose.viewer.recording import CameraSaid, SystemPicture, SystemRecording, SystemState

_SILENT = (CameraState.LOST, CameraState.RECONNECTING)
# Of people who may be anywhere, ellipsoids would only hide the room.
_WIDEST_SIGMA_M = 1.0
# A full disk is noticed within this time, and costs no more.
_FLUSH_S = 0.5


@dataclass(frozen=True)
class ViewerJob:
    """What is to be opened; see ViewerOutput."""

    path: Path | None
    rig: CameraRig
    skeleton: Skeleton
    live: bool
    port: int
    up: UpAxis


@dataclass(frozen=True, eq=False)
class TrackedDetections:
    """What the newest update says of somebody's detections."""

    residual_px: np.ndarray | None
    """(C, J)"""
    seen: Mapping[str, tuple[np.ndarray, np.ndarray]]
    """As of Tracked."""


@dataclass(frozen=True, eq=False)
class PictureToShow:
    """A picture, its people, and what was found in it."""

    picture: PictureWithPeople
    detections: Detections | None
    """None: it was not used."""
    seen: Mapping[int, Mapping[str, tuple[np.ndarray, np.ndarray]]]
    """Of each person, as of Tracked."""


@dataclass(frozen=True, eq=False)
class FrameToShow:
    """A frame, and what has come since the one before."""

    frame: LiveFrame
    sightings: Mapping[int, TrackedDetections]
    """By person."""
    images: Sequence[Detections]
    pictures: Mapping[str, PictureToShow]
    events: Sequence[TrackEvent]
    note: str = ""
    """Of the recording."""


class ViewerProcess:
    """Starts the process and gives it what it shows.

    Raises:
        ImportError: Rerun is not installed.
        OSError: the file cannot be written, the port is taken, or the process cannot be started.
    """

    n_held: int = 0
    """Frames that were shown and may not be in the file yet."""

    def __init__(self, job: ViewerJob) -> None:
        self._process = ChildProcess(__name__)
        self._process.write(job)
        try:
            self.viewer_url: str | None = self._answer()
        except BaseException:
            self._process.close()
            raise

    def send(self, shown: FrameToShow) -> None:
        """Show it; returns when it is. Raises whatever went wrong."""
        self._process.write(shown)
        self.n_held = self._answer()

    def close(self) -> None:
        """Let it write the file to its end. Raises OSError if it cannot."""
        try:
            self._process.write(None)
            self.n_held = self._answer()
        finally:
            self._process.close()

    def _answer(self) -> Any:
        try:
            answer = self._process.read()
        except EOFError:
            raise OSError("the process of the viewer has ended") from None
        if isinstance(answer, Exception):
            raise answer
        return answer


def serve() -> None:
    """Show what the parent sends, until it sends None or has ended."""
    with parent() as (receive, send):
        job: ViewerJob = receive()
        give_way(0)
        try:
            recording = open_system_recording(job.path, job.rig, job.skeleton, live=job.live, port=job.port, up=job.up)
        except Exception as error:
            send(error)
            return
        send(recording.viewer_url)
        shower = _Shower(recording)
        # Of a parent that was killed nobody waits, and the file is to be whole.
        with suppress(BrokenPipeError):
            while (shown := _next(receive)) is not None:
                send(_result_of(partial(shower.show, shown)))
        with suppress(BrokenPipeError):
            send(_result_of(shower.close))


class _Shower:
    """Shows moments, and knows how many of them are held."""

    def __init__(self, recording: SystemRecording) -> None:
        self._recording, self._moments = recording, _Moments()
        self._n_held, self._flushed_s = 0, -math.inf

    def show(self, shown: FrameToShow) -> int:
        """Returns how many are held then."""
        self._recording.log_moment(self._moments.moment(shown))
        self._n_held += 1
        if time.monotonic() > self._flushed_s + _FLUSH_S:
            self._recording.flush()
            self._n_held, self._flushed_s = 0, time.monotonic()
        return self._n_held

    def close(self) -> int:
        self._recording.close()
        return 0


def _next(receive: Callable[[], FrameToShow | None]) -> FrameToShow | None:
    """None: there is nothing more, or the parent has ended."""
    try:
        return receive()
    except (EOFError, pickle.UnpicklingError):
        return None


def _result_of(do: Callable[[], int]) -> int | Exception:
    try:
        return do()
    except Exception as error:
        return error


class _Moments:
    """From frames to what is shown of them."""

    def __init__(self) -> None:
        self._before: LiveFrame | None = None
        """The first that told of its images."""
        self._diagnosis: LiveJudgement | None = None

    def moment(self, shown: FrameToShow) -> SystemState:
        frame = shown.frame
        # Before the first image nobody is there at any time.
        frame = replace(frame, time_s=frame.published_s) if math.isnan(frame.time_s) else frame
        is_new = self._before is None or frame.time_s != self._before.time_s
        if is_new:
            self._before = frame
        assert self._before is not None
        before, self._diagnosis = self._diagnosis, frame.diagnosis
        new, gone = changes(before, frame.diagnosis)
        return SystemState(
            # Without new images time goes on, but not to the time of publishing: the next images are older.
            time_s=frame.time_s + frame.published_s - self._before.published_s,
            people=[_tracked(each, frame, shown.sightings.get(each.person), is_new) for each in frame.people],
            images=shown.images,
            pictures={name: _pictured(each, frame) for name, each in shown.pictures.items()},
            events=shown.events,
            cameras={
                camera.name: CameraSaid(camera.state.value, camera.reason, camera.state in _SILENT)
                for camera in frame.cameras
            },
            delay_s=frame.age_s if is_new and any(camera.n_used for camera in frame.cameras) else None,
            observed_share=frame.observed_share,
            note=shown.note,
            found=[*(each.text for each in new), *(each.text_when_gone for each in gone)],
        )


def _pictured(shown: PictureToShow, frame: LiveFrame) -> SystemPicture:
    picture = shown.picture
    people = [
        Tracked(
            person.person,
            person.state,
            Estimate(frame.skeleton, frame.sequence, picture.moment_s, person.positions_m, person.status),
            shown.seen.get(person.person, {}),
        )
        for person in picture.people
    ]
    return SystemPicture(picture.image_rgb, picture.moment_s, people, shown.detections)


def _tracked(person: LivePerson, frame: LiveFrame, sighting: TrackedDetections | None, is_new: bool) -> Tracked:
    """Somebody as published, with what the tracker says of their newest detections."""
    is_wide = np.trace(person.covariance_m2, axis1=1, axis2=2) > 3 * _WIDEST_SIGMA_M**2
    estimate = Estimate(
        skeleton=frame.skeleton,
        frame=frame.sequence,
        time_s=frame.time_s,
        positions_m=person.positions_m,
        status=person.status,
        covariance_m2=np.where(is_wide[:, None, None], np.nan, person.covariance_m2),
        residual_px=sighting.residual_px if sighting is not None and is_new else None,
    )
    return Tracked(person.person, person.state, estimate, {} if sighting is None else sighting.seen)
