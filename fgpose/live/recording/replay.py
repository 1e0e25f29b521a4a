"""A recording of a live system run again: the same detections through the same tracker, and the same frames."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fgpose.config import Config
from fgpose.live.clock import Clock
from fgpose.live.diagnosis.live_diagnosis import LiveDiagnosis
from fgpose.live.diagnosis.told_live import doubt
from fgpose.live.frame import LiveFrame
from fgpose.live.recording.live_recording import LiveRecording
from fgpose.live.tracking.known import doubtful
from fgpose.live.tracking.live_tracking import LiveTracking, Update
from fgpose.live.tracking.observed import volume_points_m

# A live system publishes all the time; where its disk was full for hours, nobody waits for hours.
_LONGEST_PAUSE_S = 10.0
# What frames say as it was published.
_RECORDED = ("sequence", "cameras", "observed_share", "restarts", "diagnosis")


class RecordedClock(Clock):
    """The time at which a replay is in its recording: of the frame that was published last, and going on since.

    Args:
        start_s: of the recording, Unix time.
    """

    def __init__(self, start_s: float) -> None:
        super().__init__(start_s - time.monotonic())

    def publish(self, frame: LiveFrame) -> None:
        """It is the time of this frame now."""
        self.unix_minus_monotonic_s = frame.published_s - time.monotonic()


@dataclass(frozen=True)
class ReplayComparison:
    """How the frames of a replay agree with those that were published."""

    n_frames: int = 0
    n_people: int = 0
    """Frames times people, in both."""
    n_others: int = 0
    """People of frames who are in one of them only."""
    largest_mm: float = 0.0
    """Between the positions of a joint. They are recorded in single precision."""

    def with_frame(self, again: LiveFrame, recorded: LiveFrame) -> ReplayComparison:
        """With another pair of frames."""
        ours, theirs = ({person.person: person for person in frame.people} for frame in (again, recorded))
        both = ours.keys() & theirs.keys()
        apart_mm = [
            1e3 * np.linalg.norm(ours[person].positions_m - theirs[person].positions_m, axis=-1) for person in both
        ]
        return ReplayComparison(
            n_frames=self.n_frames + 1,
            n_people=self.n_people + len(both),
            n_others=self.n_others + len(ours.keys() ^ theirs.keys()),
            largest_mm=max([self.largest_mm, *(float(np.nanmax(apart, initial=0.0)) for apart in apart_mm)]),
        )


def replay(
    recording: LiveRecording,
    publish: Callable[[LiveFrame], None],
    observers: Sequence[Callable[[Update], None]] = (),
    config: Config | None = None,
    clock: Clock | None = None,
    progress: Callable[[float], None] = lambda time_s: None,
    diagnosis: LiveDiagnosis | None = None,
) -> ReplayComparison:
    """Track what was recorded, in the same steps, and publish the frames of the recording with the people of now.

    Args:
        recording: opened.
        publish: takes each frame. Its times are those of the recording, and the states of its cameras too.
        observers: told of every update, as a recorder is.
        config: of the tracker, None: as it was.
        clock: each frame is published as long after the first as it was, but not longer than ten seconds after the
            one before; None: as fast as possible.
        progress: told of the time since the beginning of the recording, in seconds.
        diagnosis: of what is run again; frames say what it finds, in place of what was recorded.

    Raises:
        ValueError: the file is damaged other than by being cut off; the message names it.

    Warns:
        UserWarning: the recording was not closed, was cut off, or lacks records.
    """
    tracking = LiveTracking(
        recording.rig, recording.skeleton, config or recording.config, volume_points_m(recording.rig)
    )
    agreement, due_s, before_s = ReplayComparison(), 0.0 if clock is None else clock.now_s(), recording.started_s
    try:
        for again, recorded in _frames(recording, tracking, observers, diagnosis):
            if clock is not None:
                due_s += min(max(recorded.published_s - before_s, 0.0), _LONGEST_PAUSE_S)
                clock.sleep(due_s - clock.now_s())
            before_s = recorded.published_s
            publish(again)
            agreement = agreement.with_frame(again, recorded)
            progress(recorded.published_s - recording.started_s)
    finally:
        tracking.close()
    return agreement


def _frames(
    recording: LiveRecording,
    tracking: LiveTracking,
    observers: Sequence[Callable[[Update], None]],
    diagnosis: LiveDiagnosis | None,
) -> Iterator[tuple[LiveFrame, LiveFrame]]:
    """Each frame again, and as it was recorded."""
    is_tidy = True
    observers = observers if diagnosis is None else (*observers, diagnosis.observe)
    for step in recording.steps():
        if not isinstance(step, LiveFrame):
            update = tracking.track(step)
            for observe in observers:
                observe(update)
            is_tidy = False
            continue
        unknown = [camera.name for camera in step.cameras if camera.name not in recording.rig.names]
        if unknown:
            raise ValueError(f"{recording.path}: a frame has cameras that its rig has not: {', '.join(unknown)}")
        again = tracking.frame(step.published_s, step.cameras)
        said = {name: getattr(step, name) for name in _RECORDED}
        yield _diagnosed(replace(again, **said), tracking, diagnosis), step
        if not is_tidy:
            tracking.tidy()
        is_tidy = True


def _diagnosed(frame: LiveFrame, tracking: LiveTracking, diagnosis: LiveDiagnosis | None) -> LiveFrame:
    """With what a diagnosis has found now, and not when it was recorded; what cameras said stays."""
    if diagnosis is None:
        return frame
    said = diagnosis.said
    cameras = tuple(doubtful(camera, doubt(said, camera.name)) for camera in frame.cameras)
    diagnosis.publish(frame)
    share = frame.observed_share if cameras == frame.cameras else tracking.observed_share(cameras)
    return replace(frame, cameras=cameras, observed_share=share, diagnosis=said)
