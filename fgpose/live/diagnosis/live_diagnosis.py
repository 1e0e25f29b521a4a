"""The diagnosis of a running system: of the last minute, again and again."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from fgpose.geometry.camera import CameraRig
from fgpose.live.diagnosis.diagnosis_process import Diagnose, DiagnosisJob, DiagnosisProcess, Failed
from fgpose.live.diagnosis.recent import KEPT_S, Movements, RecentDetections
from fgpose.live.diagnosis.told_live import changes, told_live
from fgpose.live.frame import CameraStatus, LiveFrame, LiveJudgement
from fgpose.live.processes.closing import Closing
from fgpose.live.processes.parts import Parts
from fgpose.live.processes.priority import threads_give_way
from fgpose.live.processes.worker import Worker
from fgpose.live.tracking.live_tracking import Update
from fgpose.people_observations import Detections
from fgpose.skeleton import Skeleton

if TYPE_CHECKING:
    from fgpose.diagnosis.diagnose import Diagnosis

_LOG = logging.getLogger("fgpose.live")
_NAME = "the diagnosis"
# Whether it is time is asked so often.
_LOOKS_S = 1.0
# Of somebody's motion in the last minute; what needs more is found in the next diagnosis.
_LEAST_S = 10.0
# It is looked again when so much of motion is new, and so long after the last image that was looked at: first, and when
# something else was found, soon.
_NEW_S, _SOON_S, _LATER_S = 5.0, 20.0, 60.0
# After a failure, doubled each time; and it rests twice as long as it has worked.
_FIRST_RETRY_S, _LONGEST_RETRY_S, _RESTS = 5.0, 600.0, 2.0
# What motion tells of a clock to less is not used.
_KNOWN_SIGMA_S = 0.03
_NOBODY = "nobody was seen to move yet"


class LiveDiagnosis(Closing):
    """Looks at the detections of the last minute as ``fgpose info`` does at a recording, in a process that gives way to
    all others, and says what it finds. A process that ends, hangs or raises is begun again later, which is said.

    It is told of updates and frames, and never waits for anything then, but as its argument waits says.

    Args:
        rig: the cameras.
        skeleton: of the detections.
        diagnose: looks at a recording: fgpose.pipeline.diagnosed.diagnose_people.
        now_s: Unix time.
        parts: told when the process has ended.
        waits: each diagnosis is waited for when it is due, where time stands still meanwhile: for simulations, and for
            recordings that are run again as fast as possible.
    """

    def __init__(
        self,
        rig: CameraRig,
        skeleton: Skeleton,
        diagnose: Diagnose,
        *,
        now_s: Callable[[], float] = time.time,
        parts: Parts | None = None,
        waits: bool = False,
    ) -> None:
        self._rig, self._skeleton, self._diagnose = rig, skeleton, diagnose
        self._now_s, self._parts, self._waits = now_s, parts or Parts(now_s), waits
        self._recent, self._movements = RecentDetections(), Movements(rig.n_cameras)
        self._cameras: tuple[CameraStatus, ...] = ()
        self._looked_s = self._due_s = -math.inf
        self._retry_s = _FIRST_RETRY_S
        self._process: DiagnosisProcess | None = None
        self._said = LiveJudgement(waits_for=_NOBODY)
        self._worker = Worker(_NAME, self._run, self._parts)
        if not waits:
            self._worker.start()

    @property
    def said(self) -> LiveJudgement:
        """What it has found last; any thread may ask."""
        return self._said

    def observe(self, update: Update) -> None:
        """Take an update of the tracker."""
        self._recent.add(update.images)
        if self._waits:
            self._look()

    def publish(self, frame: LiveFrame) -> None:
        """Take what a frame says of the clocks."""
        self._cameras = frame.cameras

    def close(self) -> None:
        """End the process. Closing again does nothing."""
        self._worker.stopped.set()
        if (process := self._process) is not None:
            process.kill()
        self._worker.close()

    def _run(self) -> None:
        while not self._worker.stopped.wait(_LOOKS_S):
            self._look()

    def _look(self) -> None:
        newest_s = self._recent.newest_s
        if newest_s < self._looked_s + _LOOKS_S:
            return
        # Some cameras are later than others.
        self._movements.add(self._recent.images(self._looked_s - _LOOKS_S))
        self._movements.forget(newest_s - KEPT_S)
        self._looked_s = newest_s
        waits_for = self._waits_for(newest_s)
        if waits_for != self._said.waits_for:
            self._said = replace(self._said, waits_for=waits_for)
        if not waits_for and newest_s >= self._due_s:
            self._judge(newest_s)

    def _waits_for(self, newest_s: float) -> str:
        moving_s = self._movements.duration_s(newest_s - KEPT_S)
        if not self._said.is_judged:
            if moving_s < _LEAST_S:
                seen = f"somebody was seen to move for {moving_s:.0f} s, {_LEAST_S:.0f} s are needed"
                return seen if moving_s else _NOBODY
        elif newest_s >= self._due_s and (
            moving_s < _LEAST_S or self._movements.duration_s(self._said.to_s or 0.0) < _NEW_S
        ):
            return "hardly anybody has moved since"
        # A failure is said until the next try.
        return self._said.waits_for if newest_s < self._due_s else ""

    def _judge(self, newest_s: float) -> None:
        images, began_s = self._recent.images(newest_s - KEPT_S), time.monotonic()
        from_s = min(image.time_s for image in images)
        job = DiagnosisJob(self._diagnose, self._rig_now(), self._skeleton, from_s)
        answer = self._answer(job, images)
        if self._worker.stopped.is_set():
            return
        if isinstance(answer, Failed):
            self._failed(answer.reason, newest_s)
            return
        self._retry_s = _FIRST_RETRY_S
        now = LiveJudgement(told_live(answer.findings, from_s), from_s, newest_s, self._now_s(), answer.not_judged)
        is_news = not self._said.is_judged or any(changes(self._said, now))
        worked_s = 0.0 if self._waits else time.monotonic() - began_s
        self._due_s = newest_s + max(_SOON_S if is_news else _LATER_S, (1 + _RESTS) * worked_s)
        self._say(now)

    def _answer(self, job: DiagnosisJob, images: tuple[Detections, ...]) -> Diagnosis | Failed:
        try:
            with threads_give_way():  # from its first moment
                process = self._process = DiagnosisProcess()
        except OSError as error:
            return Failed(f"its process cannot be started: {error}")
        try:
            if self._worker.stopped.is_set():
                process.kill()
            return process.answer(job, images, self._pause)
        except TimeoutError as error:
            process.kill()
            return Failed(str(error))
        except EOFError:
            process.close()
            return Failed(f"its process ended with status {process.status}")
        finally:
            process.close()
            self._process = None

    def _pause(self, duration_s: float) -> None:
        if not self._waits:
            self._worker.stopped.wait(duration_s)

    def _failed(self, reason: str, newest_s: float) -> None:
        self._parts.restarted(_NAME, reason, wait_s=self._retry_s)
        self._due_s, self._retry_s = newest_s + self._retry_s, min(2 * self._retry_s, _LONGEST_RETRY_S)
        self._said = replace(self._said, waits_for=f"it has failed ({reason}) and is tried again")

    def _rig_now(self) -> CameraRig:
        """With what motion has told of the clocks, for which the tracker allows."""
        told_s = {
            camera.name: camera.motion_offset_s
            for camera in self._cameras
            if camera.motion_offset_s is not None
            and camera.motion_sigma_s is not None
            and camera.motion_sigma_s < _KNOWN_SIGMA_S
        }
        later_s = np.array([told_s.get(name, 0.0) for name in self._rig.names])
        return self._rig.with_time_offsets(self._rig.time_offsets_s + later_s)

    def _say(self, now: LiveJudgement) -> None:
        """What is new, and what is gone, once; and that it was looked, the first time."""
        before, self._said = self._said, now
        new, gone = changes(before, now)
        over = f"the last {(now.to_s or 0.0) - (now.from_s or 0.0):.0f} s"
        for finding in new:
            _LOG.warning("by %s %s", over, finding.text)
        for finding in gone:
            _LOG.info("in %s %s", over, finding.text_when_gone)
        if not before.is_judged and not new:
            left = f"; not judged: {', '.join(now.not_judged)}" if now.not_judged else ""
            _LOG.info("diagnosis of %s: nothing suspicious%s", over, left)
