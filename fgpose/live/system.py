"""A running system: images in, frames out, at a steady rate and whatever happens to a camera or a consumer."""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from typing import Protocol, TypeVar, runtime_checkable

from fgpose.io.live.recordings import RecordedImage
from fgpose.live.clock import Clock
from fgpose.live.diagnosis.live_diagnosis import LiveDiagnosis
from fgpose.live.frame import CameraState, CameraStatus, LiveFrame, LiveJudgement, Restarts
from fgpose.live.processes.parts import Parts
from fgpose.live.processes.worker import HANGS_S, Worker
from fgpose.live.statistics import LiveStatistics
from fgpose.live.tracking.live_tracking import LiveTracking, Update

Given = TypeVar("Given")
FrameAt = Callable[[float, Sequence[CameraStatus], tuple[Restarts, ...], LiveJudgement | None], LiveFrame]
# Without images, frames are published this often: nobody may take silence for an empty room.
_SILENT_S = 0.1
# Who tracks and has not published for so long hangs, or waits for something: another thread says what was known.
_OVERDUE_S, _LOOKS_S = 0.15, 0.02
# How the cameras are is asked so often: faults are noticed within a second.
_STATUS_S = 0.05
# What fails again and again does not keep a core busy.
_PAUSE_S = 0.05


@runtime_checkable
class Feed(Protocol):
    """Cameras whose detections come by themselves, whatever happens to a camera."""

    def take(self, timeout_s: float) -> list[RecordedImage]:
        """Detections that have come and nobody has taken, in the order in which their images were taken. If there are
        none it waits for some, but not longer than this."""
        ...

    def go_on(self, camera_names: Collection[str]) -> None:
        """What came of these cameras is about to be used, or lost: whoever looks at their images may look at the
        next."""
        ...

    def statuses(self) -> tuple[CameraStatus, ...]:
        """Of all cameras now, in the order of the rig. Images that were used are not counted here."""
        ...


@runtime_checkable
class Consumer(Protocol):
    """Takes frames; it neither waits nor raises."""

    def publish(self, frame: LiveFrame) -> None: ...


class LiveSystem:
    """Tracks and publishes. Whatever an image, an output or an observer does, it goes on; while it is never_silent,
    frames are also published where tracking takes long or hangs.

    Args:
        feed: detections and cameras.
        tracking: of the same rig.
        outputs: take every frame.
        observers: told of every update, as a recorder is; they do not wait.
        clock: of the feed.
        parts: frames say what of them has ended; told when the tracking, an output or an observer has failed.
        diagnosis: told of every update and every frame, which say what it has found.
    """

    def __init__(
        self,
        feed: Feed,
        tracking: LiveTracking,
        outputs: Sequence[Consumer],
        observers: Sequence[Callable[[Update], None]],
        clock: Clock,
        parts: Parts | None = None,
        diagnosis: LiveDiagnosis | None = None,
    ) -> None:
        self._parts, self._diagnosis = parts or Parts(clock.now_s), diagnosis
        self._feed, self._tracking, self._clock = feed, tracking, clock
        self._outputs, self._observers = tuple(outputs), tuple(observers)
        if diagnosis is not None:
            self._outputs, self._observers = (*outputs, diagnosis), (*observers, diagnosis.observe)
        self.report = LiveStatistics(tracking.rig.names)
        self._cameras, self._looked_s = feed.statuses(), clock.now_s()
        tracking.on_taken = feed.go_on
        self._published_s = self._alive_s = clock.now_s()
        """When a frame was published last, and when the thread that tracks last did."""
        self._publishing = threading.RLock()
        """Consumers get one frame at a time, observers no update between a frame and what it says."""
        self._stopped, self._has_failed = threading.Event(), False

    def run(self, until_s: float = float("inf")) -> None:
        """Track and publish in this thread until stopped, or until a time."""
        while not self._stopped.is_set() and self._clock.now_s() < until_s:
            try:
                if self._has_failed:
                    self._tracking.restart()
                    self._has_failed = False
                self._take()
                if self._clock.now_s() >= self._published_s + _SILENT_S:
                    self._publish()
            # Images at hand are lost, and who people are; the next ones are not.
            except Exception as error:
                self._parts.restarted("tracking", f"{type(error).__name__}: {error}", error)
                self._has_failed = True
                self._stopped.wait(_PAUSE_S)

    @contextmanager
    def never_silent(self) -> Iterator[None]:
        """Meanwhile a thread of its own publishes, in real time, what was known last, with its age and how the cameras
        are now, whenever the thread that tracks does not."""
        publisher = Worker("publishing without news", lambda: self._speak_up(publisher), self._parts)
        publisher.start()
        try:
            yield
        finally:
            publisher.close()

    def stop(self) -> None:
        """Let run return; from any thread."""
        self._stopped.set()

    def _take(self) -> None:
        """What has come, or what comes until a frame is due."""
        due_s = min(self._tracking.deadline_s, self._published_s + _SILENT_S)
        images = self._feed.take(max(due_s - self._clock.now_s(), 0.0))
        if self._clock.now_s() >= self._looked_s + _STATUS_S:
            self._cameras, self._looked_s = self._feed.statuses(), self._clock.now_s()
            self._parts.look()
        for image in images:
            self._tell(self._tracking.add(image, self._clock.now_s()))
        expected = [camera.name for camera in self._cameras if camera.state is CameraState.OK]
        self._tell(self._tracking.look(self._clock.now_s(), expected))

    def _tell(self, updates: Sequence[Update]) -> None:
        for update in updates:
            is_news = any(image.is_used for image in update.images)
            with self._publishing:
                for observe in self._observers:
                    self._give(observe, update, "an observer")
                if is_news:
                    self._publish()
            if is_news:
                self._tracking.tidy()

    def _publish(self) -> None:
        self._alive_s = self._clock.now_s()
        self._give_frame(self._tracking.frame, self._cameras)

    def _speak_up(self, publisher: Worker) -> None:
        is_said = False
        while not publisher.stopped.wait(_LOOKS_S):
            if self._clock.now_s() >= self._published_s + _OVERDUE_S:
                self._give_frame(self._tracking.frame_without_news, self._feed.statuses())
            silent_s = self._clock.now_s() - self._alive_s
            if silent_s > HANGS_S and not is_said:
                self._parts.hangs("tracking", f"it hangs: nothing for {silent_s:.1f} s")
            is_said = silent_s > HANGS_S

    def _give_frame(self, frame_at: FrameAt, cameras: Sequence[CameraStatus]) -> None:
        with self._publishing:
            now_s = self._published_s = self._clock.now_s()
            said = None if self._diagnosis is None else self._diagnosis.said
            frame = frame_at(now_s, cameras, self._parts.so_far(), said)
            for output in self._outputs:
                self._give(output.publish, frame, "an output")
            self.report.add(frame)

    def _give(self, take: Callable[[Given], None], given: Given, name: str) -> None:
        """One that raises, which none should, does not keep the others from it."""
        try:
            take(given)
        except Exception as error:
            self._parts.restarted(name, f"{type(error).__name__}: {error}", error)
