"""A live system in simulated time, with people who come and go and with faults: what came of each fault."""

from __future__ import annotations

import os
import signal
import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

import fgpose
from fgpose.association.track import Tracked
from fgpose.geometry.camera import CameraRig
from fgpose.live.clock import SimulatedClock
from fgpose.live.frame import CameraState, LiveFrame
from fgpose.live.system import LiveSystem
from fgpose.live.tracking.live_tracking import LiveTracking
from fgpose.live.tracking.observed import volume_points_m
from fgpose.people_observations import Detections
from live_soak_consumer import SimulatedConsumer
from live_soak_plan import SoakPlan, Trouble
from simulated_cameras import PlayedFault, SimulatedCameras
from simulated_visitors import SimulatedClip, Visitors

START_S = 1.7e9
# After a fault is over, estimates must be as good as without it.
_SETTLES_S, _COMPARED_S = 1.0, 4.0
_MOST_ALARMS = 100
_REAL_S = 0.02


@dataclass
class Comparison:
    """Sums over frames and people, with the fault and without it."""

    n: int = 0
    error_mm: float = 0.0
    usual_mm: float = 0.0
    sigma_mm: float = 0.0
    usual_sigma_mm: float = 0.0
    n_missing: int = 0
    """Who would be followed without the fault."""


@dataclass
class FaultOutcome:
    """Of a fault. Times are seconds after its beginning or end; None: it never was."""

    kind: str
    cameras: tuple[str, ...]
    begin_s: float
    """Since the start."""
    end_s: float
    noticed_s: float | None = None
    rejoined_s: float | None = None
    said: str = ""
    during: Comparison = field(default_factory=Comparison)
    after: Comparison = field(default_factory=Comparison)


@dataclass(frozen=True, eq=False)
class Usual:
    """Of a clip without faults: errors and standard deviations, (image, person) in metres, NaN: not followed."""

    error_m: np.ndarray
    sigma_m: np.ndarray


class LiveSoak:
    """The system under trouble. It takes its own frames.

    Args:
        rig: the cameras.
        clips: of the people.
        plan: who comes when, and what happens.
        rate_hz: of the cameras.
        seed: of everything else.
        usual: of each clip, to compare with.
        config: of the tracker.
    """

    def __init__(
        self,
        rig: CameraRig,
        clips: Sequence[SimulatedClip],
        plan: SoakPlan,
        rate_hz: float,
        seed: int,
        config: fgpose.Config,
        usual: Sequence[Usual] | None = None,
    ) -> None:
        clock = SimulatedClock(START_S)
        self.plan, self.usual, self._clips = plan, usual, clips
        self.visitors = Visitors(clips, START_S, rate_hz, plan.visit)
        self.feed = SimulatedCameras(rig, clock, self.visitors.seen, rate_hz, config.online.lag_s, seed)
        skeleton = clips[0].scene.motion.skeleton
        self.tracking = LiveTracking(rig, skeleton, config, volume_points_m(rig))
        self.consumer = SimulatedConsumer()
        outputs = (self.consumer.output, self)
        self.system = LiveSystem(self.feed, self.tracking, outputs, (), clock)
        self.outcome: FaultOutcome | None = None
        self.scored: list[list[tuple[int, np.ndarray, np.ndarray]]] = [[] for _ in clips]
        """Of each clip without faults: image, errors and standard deviations."""
        self.alarms: list[str] = []
        """Cameras without a fault that were not ok."""
        self.n_alarms = self.n_others = self.n_scored = 0
        """Frames with such a camera; people who were not there; and people who were."""
        self.longest_gap_s, self.n_warnings = 0.0, 0
        self._published_s, self._sequence = START_S, -1
        self._trouble: Trouble | None = None
        self._began = self._ended = False
        self._n_failures = 0
        self._process_id: int | None = None

    def run_minute(self, minute: int) -> FaultOutcome | None:
        """Simulate a minute, and tell what came of its fault."""
        self._trouble, self._began, self._ended = self.plan.trouble(minute), False, False
        self.outcome = None
        if self._trouble is not None:
            trouble = self._trouble
            self.outcome = FaultOutcome(trouble.kind, trouble.cameras, trouble.begin_s, trouble.end_s)
            if isinstance(trouble.fault, PlayedFault):
                self.feed.add(trouble.fault)
        with warnings.catch_warnings():
            warnings.simplefilter("always")
            warnings.showwarning = self._warned  # pyrefly: ignore[bad-assignment]
            self.system.run(START_S + 60.0 * (minute + 1))
        return self.outcome

    def close(self) -> None:
        self.consumer.end()
        self.consumer.output.close()
        self.tracking.close()

    def usual_of_clips(self) -> list[Usual]:
        """From what was scored: the mean over the times that each clip was played."""
        return [_usual(clip, scored) for clip, scored in zip(self._clips, self.scored, strict=True)]

    def publish(self, frame: LiveFrame) -> None:
        """See fgpose.live.system.Consumer."""
        if frame.sequence != self._sequence + 1:
            raise AssertionError(f"frame {frame.sequence} after {self._sequence}")
        self.longest_gap_s = max(self.longest_gap_s, frame.published_s - self._published_s)
        self._sequence, self._published_s = frame.sequence, frame.published_s
        now_s = frame.published_s - START_S
        self._look_at_cameras(frame, now_s)
        self._look_at_rest(now_s)
        self._score(frame, now_s)

    def _look_at_cameras(self, frame: LiveFrame, now_s: float) -> None:
        troubled, outcome = self._trouble.cameras if self._trouble is not None else (), self.outcome
        bad = [camera for camera in frame.cameras if camera.state is not CameraState.OK]
        wrong = [camera for camera in bad if camera.name not in troubled]
        if wrong and now_s > _SETTLES_S:
            self.n_alarms += 1
            if len(self.alarms) < _MOST_ALARMS:
                self.alarms += [f"{now_s:.1f} s: {each.name} {each.state.value}: {each.reason}" for each in wrong]
        if outcome is None or not troubled or now_s < outcome.begin_s:
            return
        noticed = [camera for camera in bad if camera.name in troubled]
        if outcome.noticed_s is None and len(noticed) == len(troubled):
            outcome.noticed_s = now_s - outcome.begin_s
            outcome.said = f"{noticed[0].state.value}: {noticed[0].reason}"
        if noticed:
            outcome.rejoined_s = None
        elif outcome.noticed_s is not None and outcome.rejoined_s is None:
            outcome.rejoined_s = max(now_s - outcome.end_s, 0.0)

    def _look_at_rest(self, now_s: float) -> None:
        """Faults of what is not a camera."""
        trouble, outcome = self._trouble, self.outcome
        if trouble is None or outcome is None or trouble.fault is not None or now_s < trouble.begin_s:
            return
        if trouble.kind in ("consumer dies", "consumer hangs"):
            self._look_at_consumer(trouble.kind, outcome, now_s)
        elif not self._began:
            self._began = True
            self._break(trouble.kind)
        elif outcome.noticed_s is None and self._is_mended(trouble.kind):
            outcome.noticed_s, outcome.rejoined_s = now_s - trouble.begin_s, 0.0

    def _look_at_consumer(self, kind: Any, outcome: FaultOutcome, now_s: float) -> None:
        is_working = self.consumer.output.state.is_working
        if outcome.rejoined_s is None:
            # Outputs work in real time, and a simulated minute may be over in one second.
            time.sleep(_REAL_S)
        if not self._began:
            self._began = True
            self.consumer.begin(kind)
        elif not self._ended and not is_working:
            self._ended, outcome.end_s = True, now_s
            outcome.noticed_s, outcome.said = self.consumer.real_s, self.consumer.output.state.last_error
            self.consumer.end()
        elif self._ended and is_working and outcome.rejoined_s is None:
            outcome.rejoined_s = self.consumer.real_s

    def _break(self, kind: str) -> None:
        tracker = self.tracking._tracker
        self._n_failures = self.tracking.n_failures
        if kind == "tracker":
            tracker.update = _fail
        elif kind == "estimator" and (others := tracker._estimators._others):
            self._process_id = others[0].process_id
            os.kill(self._process_id, signal.SIGKILL)
            # Until it has ended takes real time, in which simulated seconds pass.
            os.waitid(os.P_PID, self._process_id, os.WEXITED | os.WNOWAIT)

    def _is_mended(self, kind: str) -> bool:
        if kind == "tracker":
            return self.tracking.n_failures > self._n_failures
        others = self.tracking._tracker._estimators._others
        return bool(others) and others[0].process_id != self._process_id

    def _score(self, frame: LiveFrame, now_s: float) -> None:
        scored = self.visitors.score(frame)
        if scored is None:
            return
        visit, image, scores = scored
        self.n_others += scores.n_others
        self.n_scored += int(scores.is_there.sum())
        if self.usual is None:
            self.scored[visit.clip].append((image, scores.error_m, scores.sigma_m))
            return
        outcome = self.outcome
        if outcome is None:
            return
        usual = self.usual[visit.clip]
        if outcome.begin_s <= now_s < outcome.end_s:
            _compare(outcome.during, scores.error_m, scores.sigma_m, usual, image)
        elif _SETTLES_S <= now_s - outcome.end_s < _COMPARED_S:
            _compare(outcome.after, scores.error_m, scores.sigma_m, usual, image)

    def _warned(self, *_: Any) -> None:
        self.n_warnings += 1


def _compare(to: Comparison, error_m: np.ndarray, sigma_m: np.ndarray, usual: Usual, image: int) -> None:
    for person in np.flatnonzero(np.isfinite(usual.error_m[image])).tolist():
        if np.isnan(error_m[person]):
            to.n_missing += 1
            continue
        to.n += 1
        to.error_mm += 1e3 * float(error_m[person])
        to.usual_mm += 1e3 * float(usual.error_m[image, person])
        to.sigma_mm += 1e3 * float(sigma_m[person])
        to.usual_sigma_mm += 1e3 * float(usual.sigma_m[image, person])


def _usual(clip: SimulatedClip, scored: list[tuple[int, np.ndarray, np.ndarray]]) -> Usual:
    means = []
    for column in (1, 2):
        mean_m = np.full((clip.n_images, clip.scene.motion.n_people), np.nan)
        for image in range(clip.n_images):
            own = np.array([each[column] for each in scored if each[0] == image])
            # Who is followed sometimes only is no measure.
            if len(own):
                mean_m[image] = own.mean(axis=0)
        means.append(mean_m)
    return Usual(*means)


def _fail(images: Sequence[Detections]) -> list[Tracked]:
    raise RuntimeError("a fault of the soak")
