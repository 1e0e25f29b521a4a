"""Distances of the simulated live system against the truth: ``python benchmarks/live_distances.py``. Exit code 1 unless
no more of them than their quantile allows are larger than the truth without a fault.

The people, cameras, faults of cameras, tracker and processes of live_soak.py, and a robot whose poses stop, come late,
are dated ahead of the clock or are no rigid transforms. Distances are measured twice at each frame: before it, when
what is known is oldest, and after it. An operator resets the faults once a second. Who appears out of nowhere counts
after a second, as nobody walks into a room so.
"""

from __future__ import annotations

import faulthandler
import json
import logging
import math
import sys
from collections import Counter
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from live_soak_plan import Plan
from live_soak_run import START_S, Soak
from rich.progress import track
from simulated_visitors import made_clips, room_rig

import fgpose
from fgpose.association.track import TrackState
from fgpose.live.assurance import FOUND_S
from fgpose.live.cell import Capsule, Cell, Limits, Link
from fgpose.live.distances import DistanceMonitor, LinkDistance
from fgpose.live.frame import CameraState, CameraStatus, LiveFrame, LivePerson

_VISIT_S, _RATE_HZ, _LOCKED_UP_S = 12.0, 8.0, 300.0
_RESET_EVERY_S = 1.0
# Positions are interpolated between frames of motion capture, and joints are not the surface.
_TOLERANCE_M = 0.02
_CELL = Cell(
    (
        Link("arm", (Capsule((0.0, 0.0, 0.0), (0.0, 0.0, 0.4), 0.08),)),
        Link("table", (Capsule((0.8, 0.0, 0.4), (0.8, 0.0, 0.9), 0.3),), is_fixed=True),
    ),
    Limits(min_observed_share=0.5),
)
_ROBOT_FAULTS = ("none", "stops", "late", "ahead", "scaled")


@dataclass
class Result:
    """Of what was simulated so far."""

    hours: float = 0.0
    n_faults: int = 0
    """Of cameras, tracker, estimators and robot."""
    n_said: int = 0
    """Distances without a fault while somebody was there."""
    n_too_large: int = 0
    largest_m: float = -math.inf
    """By how much one was larger than the truth."""
    n_nobody: int = 0
    """Of these, nobody while somebody was there."""
    worst: list[str] = field(default_factory=list)
    n_calm: int = 0
    """Distances while nothing was wrong."""
    n_calm_said: int = 0
    """Of these, without a fault."""
    reasons: dict[str, int] = field(default_factory=dict)
    """Of faults while nothing was wrong."""

    @property
    def too_large(self) -> float:
        return self.n_too_large / max(self.n_said, 1)

    @property
    def availability(self) -> float:
        return self.n_calm_said / max(self.n_calm, 1)


class DistanceSoak(Soak):
    """The live system under trouble, and a robot beside it."""

    def __init__(self, *args: Any, seed: int, **options: Any) -> None:
        super().__init__(*args, seed=seed, **options)
        rig, skeleton = self.tracking.rig, self.tracking.skeleton
        self.monitor, self._truth = (DistanceMonitor(_CELL, rig, skeleton) for _ in range(2))
        self._ok = tuple(CameraStatus(name, CameraState.OK, unproven_s=0.0) for name in rig.names)
        self._seed, self._reset_s, self._there_since_s = seed, -math.inf, dict[int, float]()
        self.result = Result()
        self._reasons = Counter[str]()

    def publish(self, frame: LiveFrame) -> None:
        super().publish(frame)
        self._measure(frame.published_s)
        self.monitor.publish(frame)
        self._measure(frame.published_s)

    def run_minute(self, minute: int) -> Any:
        outcome = super().run_minute(minute)
        self.result.hours = (minute + 1) / 60
        self.result.n_faults += (outcome is not None) + (self._robot_fault(minute)[0] != "none")
        self.result.reasons = dict(self._reasons.most_common(10))
        return outcome

    def _robot_fault(self, minute: int) -> tuple[str, float, float]:
        rng = np.random.default_rng([self._seed, 3, minute])
        begin_s = 60.0 * minute + float(rng.uniform(8.0, 25.0))
        return str(rng.choice(_ROBOT_FAULTS)), begin_s, begin_s + float(rng.uniform(0.5, 4.0))

    def _robot(self, now_s: float) -> tuple[dict[str, np.ndarray], dict[str, float], bool]:
        """Poses, of when they are, and whether something is wrong with them, or was until the reset. It circles with
        half a metre a second."""
        kind, begin_s, end_s = self._robot_fault(int((now_s - START_S) / 60.0))
        since_s = now_s - START_S - begin_s
        is_wrong = kind != "none" and 0 <= since_s < end_s - begin_s
        is_latched = kind != "none" and 0 <= since_s < end_s - begin_s + 2 * _RESET_EVERY_S
        at_s = now_s - 0.005
        if is_wrong:
            at_s = {"stops": START_S + begin_s, "late": at_s - 0.7, "ahead": at_s + 0.4}.get(kind, at_s)
        pose = np.eye(4)
        angle = at_s % (4 * math.pi)
        pose[:3, 3] = 0.5 * math.cos(angle), 0.5 * math.sin(angle), 0.9
        if is_wrong and kind == "scaled":
            pose[:3, :3] *= 1.05
        return {"arm": pose}, {"arm": at_s}, is_latched

    def _measure(self, now_s: float) -> None:
        if now_s >= self._reset_s + _RESET_EVERY_S:
            self._reset_s = now_s
            self.monitor.reset()
        poses, poses_s, is_wrong = self._robot(now_s)
        said = self.monitor.measure(poses, now_s, poses_s)
        is_calm = not is_wrong and self._is_calm(now_s - START_S)
        self.result.n_calm += is_calm * len(said)
        self.result.n_calm_said += is_calm * sum(each.fault is None for each in said)
        if is_calm:
            self._reasons.update(each.fault.reason[:60] for each in said if each.fault is not None)
        true_m = self._true_m(now_s, poses)
        if true_m:
            for each in said:
                self._compare(each, true_m[each.link], now_s)

    def _compare(self, said: LinkDistance, true_m: float, now_s: float) -> None:
        if said.fault is not None:
            return
        self.result.n_said += 1
        over_m = said.distance_m - true_m
        self.result.largest_m = max(self.result.largest_m, over_m)
        if over_m > _TOLERANCE_M:
            self.result.n_too_large += 1
            self.result.n_nobody += math.isinf(said.distance_m)
            if len(self.result.worst) < 50:
                trouble = self._trouble.kind if self._trouble else ""
                self.result.worst.append(
                    f"{now_s - START_S:.2f} s: {said.link} {said.distance_m:.2f}, true {true_m:.2f} m; {trouble}"
                )

    def _is_calm(self, now_s: float) -> bool:
        """Nothing is wrong, and has not been for as long as it takes until that is known, and a reset after it."""
        trouble = self._trouble
        wait_s = FOUND_S + 2 * _RESET_EVERY_S + 1.0
        begun = now_s > wait_s
        return begun and (
            trouble is None or not trouble.begin_s <= now_s <= max(trouble.end_s, trouble.begin_s) + wait_s
        )

    def _true_m(self, now_s: float, poses: dict[str, np.ndarray]) -> dict[str, float]:
        """Distance of each link from the nearest of those who have been there for a second; nothing: nobody has."""
        number = self.visitors.number(now_s)
        visit = self.visitors.of(int(number))
        truth_m = (
            np.zeros((0, 0, 3)) if visit is None else self._clips[visit.clip].truth_m((number - visit.first) / _RATE_HZ)
        )
        there = [who for who in range(len(truth_m)) if np.isfinite(truth_m[who]).all()]
        self._there_since_s = {who: self._there_since_s.get(who, now_s) for who in there}
        people = tuple(_exactly(who, truth_m[who]) for who in there if now_s - self._there_since_s[who] > FOUND_S)
        if not people:
            return {}
        skeleton = self.tracking.skeleton
        self._truth.publish(LiveFrame(0, now_s, now_s, skeleton, people, self._ok, 1.0, now_s - 60.0))
        rigid = {"arm": poses["arm"].copy()}
        rigid["arm"][:3, :3] = np.eye(3)
        return {each.link: each.expected_m for each in self._truth.measure(rigid, now_s)}


def _exactly(who: int, joints_m: np.ndarray) -> LivePerson:
    n = len(joints_m)
    return LivePerson(
        who, TrackState.CONFIRMED, joints_m, np.tile(1e-12 * np.eye(3), (n, 1, 1)), np.full(n, 2), np.ones(n)
    )


def simulate(minutes: int, seed: int) -> Result:
    """So many minutes, with a progress bar."""
    rig, config = room_rig(), fgpose.Config(online={"lag_s": 0.3}, tracking={"max_processes": 1})
    clips = made_clips(rig, _VISIT_S, _RATE_HZ, seed)
    plan = Plan(clips, rig.names, _RATE_HZ, START_S, seed)
    run = DistanceSoak(rig, clips, plan, _RATE_HZ, seed=seed + 1, config=config)
    try:
        for minute in track(range(minutes), "simulated minutes"):
            faulthandler.dump_traceback_later(_LOCKED_UP_S, exit=True)
            run.run_minute(minute)
    finally:
        faulthandler.cancel_dump_traceback_later()
        run.close()
    return run.result


def main(hours: float = 24.0, seed: int = 1, output: Path = Path("out/live_distances.json")) -> int:
    """Simulate, and print what was said.

    Args:
        hours: simulated.
        seed: of people and faults.
        output: file of the results.
    """
    logging.getLogger("fgpose.live").setLevel(logging.CRITICAL)
    result = simulate(round(60 * hours), seed)
    output.parent.mkdir(parents=True, exist_ok=True)
    output.write_text(json.dumps(asdict(result), indent=1) + "\n", encoding="utf-8")
    print(json.dumps(asdict(result), indent=1))
    print(f"too large without a fault: {result.too_large:.5f}; said while nothing was wrong: {result.availability:.4f}")
    return int(result.too_large > 1 - _CELL.limits.quantile)


if __name__ == "__main__":
    sys.exit(tyro.cli(main))
