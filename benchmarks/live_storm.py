"""Distances of the live system under faults of every kind at once: ``python benchmarks/live_storm.py --hours 1000``.

All that decides what may be said is that of ``fgpose live``, on a simulated clock: messages and their senders, clocks,
states of cameras, moments, frames, poses of the robot, distances and faults. Only the estimation is not: a stand-in
recognises what images show, and errs as it says (storm_visitors.py). So a simulated hour takes seconds, not minutes as
in live_distances.py. Sockets, threads, processes and pictures are not simulated. Distances are measured about once a
second, and 15 times a second from before a fault until after it.
"""

from __future__ import annotations

import functools
import json
import logging
import math
import sys
from collections import Counter
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from rich.progress import track

import fgpose
from distance_truth import CELL, RESET_EVERY_S, DistanceResult, Judge, world_T_arm
from fgpose.io.atomic import write_text
from fgpose.io.live.recordings import RecordedImage
from fgpose.live.clock import SimulatedClock
from fgpose.live.frame import CameraStatus, LiveFrame
from fgpose.live.processes.pending_detections import PendingDetections
from fgpose.live.system import LiveSystem
from fgpose.live.tracking.observed import volume_points_m
from fgpose.robot.assurance import FOUND_S
from fgpose.robot.distances import DistanceMonitor
from fgpose.robot.robot_poses import measured
from simulated_visitors import SimulatedClip, Visit, room_rig
from storm_plan import GROUPS, PlannedFault, StormSession, session
from storm_reception import Reception
from storm_senders import StormSenders
from storm_visitors import StandInTracker, StandInTracking, StormVisitors
from timeline import Timeline

SESSION_S = 600.0
_START_S = 1.7e9
_RATE_HZ, _VISIT_S, _N_PEOPLE = 5.0, 50.0, (1, 2)
# Between visits, so that the judge has looked: who comes next appears elsewhere, and has to be found first.
_NOBODY_S = 2.0
_LAG_S = 0.3
_DENSE_S, _USUAL_S, _SPARSE_S = 1 / 12, 0.3, (0.5, 1.5)
# Dense from shortly before a fault begins, or ends, for so long.
_BEFORE_S, _AFTER_S = 0.2, 1.5
# What is wrong is known, reset and over by then.
_SETTLES_S = FOUND_S + 2 * RESET_EVERY_S + 1.0
# A clock that was wrong is believed again after half a minute.
_CLOCKS_SETTLE_S = 30.0


class Storm:
    """Sessions of the live system, one after the other.

    Args:
        seed: of everything.
        result: of the first of them, to which that of the others is added.
    """

    def __init__(self, seed: int, result: DistanceResult | None = None) -> None:
        self._seed, self.result = seed, result or DistanceResult()
        self.rig, self.clips = room_rig(), made_clips(seed)
        self._volume_m = volume_points_m(self.rig)
        self._kinds = Counter(self.result.faults)

    def run_session(self) -> None:
        """One, from its start to its end."""
        rng = np.random.default_rng([self._seed, self.result.n_sessions])
        self.result.n_sessions += 1
        _Session(self, rng, self._volume_m).run()

    def visit(self, minute: int) -> Visit:
        """Who comes: the storm of each session begins anew."""
        rng = np.random.default_rng([self._seed, self.result.n_sessions, minute])
        first = round((60.0 * minute + float(rng.uniform(_NOBODY_S, 60.0 - _VISIT_S))) * _RATE_HZ)
        return Visit(int(rng.integers(len(self.clips))), first)

    def count(self, done: StormSession) -> None:
        """A session is over."""
        self._kinds.update(fault.kind for fault in done.faults)
        self._kinds.update(kind for kind, _ in done.start.values())
        self.result.faults = dict(sorted(self._kinds.items()))
        self.result.n_faults = self._kinds.total()
        self.result.hours = self.result.n_sessions * SESSION_S / 3600


@functools.cache
def made_clips(seed: int) -> tuple[SimulatedClip, ...]:
    """Of the people of a storm."""
    return tuple(SimulatedClip.made(room_rig(), n, _VISIT_S, _RATE_HZ, 100 * seed + k) for k, n in enumerate(_N_PEOPLE))


class _Session:
    """A live system. It is its own feed and output."""

    def __init__(self, storm: Storm, rng: np.random.Generator, volume_m: np.ndarray) -> None:
        self._storm, self._rng, self._clock = storm, rng, SimulatedClock(_START_S)
        rig, skeleton = storm.rig, storm.clips[0].scene.motion.skeleton
        self._visitors = StormVisitors(storm.clips, _START_S, _RATE_HZ, storm.visit)
        self._timeline = Timeline(self._clock)
        self.plan = session(rig.names, _START_S, SESSION_S, rng)
        self._arrivals = PendingDetections(rig.names)
        self._reception = Reception(self.plan, rig, skeleton, self._timeline, _LAG_S, self._arrivals.put, rng)
        self._senders = StormSenders(self.plan, self._reception, self._visitors, self._timeline, _RATE_HZ, rng)

        def new_tracker() -> StandInTracker:
            return StandInTracker(self._visitors, rig, skeleton, self._clock.now_s, rng, self._trouble_tracker)

        config = fgpose.Config(online={"lag_s": _LAG_S}, tracking={"max_processes": 1})
        self._tracking = StandInTracking(new_tracker, rig, skeleton, config, volume_m)
        self._system = LiveSystem(self, self._tracking, (self,), (), self._clock)
        self._monitor = DistanceMonitor(CELL, rig, skeleton)
        self._judge = Judge(rig, skeleton, storm.result)
        self._active: dict[str, PlannedFault] = {}
        self._published_s, self._held_s = _START_S, 0.0
        """The last frame, and for how long since then the process was stopped or the tracker did not answer."""

    def run(self) -> None:
        for fault in self.plan.faults:
            self._timeline.at(fault.begin_s, lambda fault=fault: self._begin(fault))
            self._timeline.at(fault.end_s, lambda fault=fault: self._end(fault))
        self._timeline.at(_START_S + 0.01, self._measure)
        self._system.run(_START_S + SESSION_S)
        self._storm.count(self.plan)

    def take(self, timeout_s: float) -> list[RecordedImage]:
        """See Feed."""
        if self._active.pop("tracking fails", None):
            raise RuntimeError("a fault of the storm")
        return self._timeline.until_any(self._arrivals, timeout_s)

    def go_on(self, camera_names: object) -> None:
        """See Feed."""

    def statuses(self) -> tuple[CameraStatus, ...]:
        """See Feed."""
        now_s = self._clock.now_s()
        return tuple(camera.status(now_s) for camera in self._reception.live.values())

    def publish(self, frame: LiveFrame) -> None:
        """See Consumer."""
        self._monitor.publish(frame)
        self._silent(frame.published_s - self._published_s - self._held_s)
        self._published_s, self._held_s = frame.published_s, 0.0
        if "output raises" in self._active:
            raise RuntimeError("a fault of the storm")

    def _silent(self, duration_s: float) -> None:
        result = self._storm.result
        result.longest_silence_s = max(result.longest_silence_s, duration_s)

    def _begin(self, fault: PlannedFault) -> None:
        self._active[fault.kind] = fault
        if fault.kind == "stopped":
            self._timeline.pause(fault.end_s - fault.begin_s)
            self._held_s += fault.end_s - fault.begin_s
        self._senders.begin_fault(fault)

    def _end(self, fault: PlannedFault) -> None:
        self._active.pop(fault.kind, None)
        self._senders.end_fault(fault)

    def _trouble_tracker(self, what: str) -> None:
        """In place of what fails in it."""
        if what == "tidy":
            if self._active.pop("tidying fails", None):
                raise RuntimeError("a fault of the storm")
            return
        if self._active.pop("fails", None) or "fails again" in self._active:
            raise RuntimeError("a fault of the storm")
        hangs, ends = self._active.pop("hangs", None), self._active.pop("estimator ends", None)
        wait_s = (hangs.end_s - hangs.begin_s if hangs else 0.0) + (ends.amount if ends else 0.0)
        tracker: Any = self._tracking._tracker
        tracker.n_restarts += ends is not None
        if wait_s:
            self._held_s += wait_s
            self._timeline.advance(self._clock.now_s() + wait_s)

    def _measure(self) -> None:
        now_s = self._clock.now_s()
        self._reception.read_robot()
        said = measured(self._monitor, self._reception.robot, now_s)
        people_m = self._visitors.people_m(self._visitors.number(now_s))
        recent = self._recent(now_s)
        self._judge.look(said, people_m, world_T_arm(now_s), now_s, self._in_words(recent, now_s))
        edges_s = [edge_s for fault in recent for edge_s in (fault.begin_s, fault.end_s)]
        if any(-_BEFORE_S <= now_s - edge_s <= _AFTER_S for edge_s in edges_s):
            wait_s = _DENSE_S
        else:
            is_over = all(edge_s + _SETTLES_S < now_s for edge_s in edges_s)
            wait_s = float(self._rng.uniform(*_SPARSE_S)) if is_over else _USUAL_S
        self._timeline.at(now_s + wait_s, self._measure)

    def _recent(self, now_s: float) -> list[PlannedFault]:
        """Faults that are about to begin, or were over a moment ago."""
        until_s = now_s + _SPARSE_S[1] + _BEFORE_S
        return [
            fault
            for fault in self.plan.faults
            if fault.begin_s <= until_s
            and now_s <= fault.end_s + _SETTLES_S + (_CLOCKS_SETTLE_S if fault.kind in GROUPS["clock"] else 0.0)
        ]

    def _in_words(self, recent: list[PlannedFault], now_s: float) -> str:
        """All that is wrong; empty: nothing."""
        words = [
            f"{fault.kind} {','.join(fault.cameras)} {fault.begin_s - _START_S:.2f}-{fault.end_s - _START_S:.2f}"
            for fault in recent
        ]
        words += [f"{name} {kind} {much_s:.2f}" for name, (kind, much_s) in self.plan.start.items()]
        if now_s < _START_S + _SETTLES_S:
            words.append("the start")
        return "; ".join(words)


def simulate(session: int, seed: int) -> DistanceResult:
    """One of the sessions of a storm, alone."""
    storm = Storm(seed, DistanceResult(n_sessions=session))
    storm.run_session()
    return storm.result


def main(hours: float = 1.0, seed: int = 1, output: Path = Path("out/live_storm")) -> int:
    """Simulate, and print what was said, in all storms whose results are there.

    Args:
        hours: simulated with this seed; sessions whose results are there already are not simulated again.
        seed: of people and faults. Several can be simulated at the same time.
        output: folder of the results, a file for each seed, written after each session.
    """
    logging.getLogger("fgpose.live").setLevel(logging.CRITICAL)
    output.mkdir(parents=True, exist_ok=True)
    file = output / f"seed_{seed}.json"
    storm = Storm(seed, _read(file) if file.exists() else None)
    for _ in track(range(storm.result.n_sessions, math.ceil(hours * 3600 / SESSION_S)), "simulated sessions"):
        storm.run_session()
        write_text(file, json.dumps(asdict(storm.result), indent=1) + "\n")
    result = DistanceResult()
    for each in sorted(output.glob("seed_*.json")):
        result.add(_read(each))
    print(json.dumps(asdict(result), indent=1))
    print(f"too large without a fault: {result.too_large:.6f}; said while nothing was wrong: {result.availability:.5f}")
    return int(not result.is_good)


def _read(file: Path) -> DistanceResult:
    return DistanceResult(**json.loads(file.read_text(encoding="utf-8")))


if __name__ == "__main__":
    sys.exit(tyro.cli(main))
