"""Distances of the simulated live system against the truth: ``python benchmarks/live_distances.py``. Exit code 1 unless
no more of them than their quantile allows are larger than the truth without a fault.

The people, cameras, faults of cameras, tracker and processes of live_soak.py, and a robot whose poses stop, come late,
are dated ahead of the clock or are no rigid transforms. Distances are measured twice at each frame: before it, when
what is known is oldest, and after it.
"""

from __future__ import annotations

import faulthandler
import json
import logging
import math
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from rich.progress import track

import fgpose
from distance_truth import CELL, RESET_EVERY_S, DistanceResult, Judge, world_T_arm
from fgpose.live.frame import LiveFrame
from fgpose.robot.assurance import FOUND_S
from fgpose.robot.distances import DistanceMonitor
from live_soak_plan import SoakPlan
from live_soak_run import START_S, LiveSoak
from simulated_visitors import made_clips, room_rig

_VISIT_S, _RATE_HZ, _LOCKED_UP_S = 12.0, 8.0, 300.0
_ROBOT_FAULTS = ("none", "stops", "late", "ahead", "scaled")


class DistanceSoak(LiveSoak):
    """The live system under trouble, and a robot beside it."""

    def __init__(self, *args: Any, seed: int, **options: Any) -> None:
        super().__init__(*args, seed=seed, **options)
        rig, skeleton = self.tracking.rig, self.tracking.skeleton
        self.monitor, self.result = DistanceMonitor(CELL, rig, skeleton), DistanceResult()
        self._judge = Judge(rig, skeleton, self.result)
        self._seed, self._reset_s = seed, -math.inf

    def publish(self, frame: LiveFrame) -> None:
        super().publish(frame)
        self._measure(frame.published_s)
        self.monitor.publish(frame)
        self._measure(frame.published_s)

    def run_minute(self, minute: int) -> Any:
        outcome = super().run_minute(minute)
        self.result.hours = (minute + 1) / 60
        self.result.n_faults += (outcome is not None) + (self._robot_fault(minute)[0] != "none")
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
        is_latched = kind != "none" and 0 <= since_s < end_s - begin_s + 2 * RESET_EVERY_S
        at_s = now_s - 0.005
        if is_wrong:
            at_s = {"stops": START_S + begin_s, "late": at_s - 0.7, "ahead": at_s + 0.4}.get(kind, at_s)
        pose = world_T_arm(at_s)
        if is_wrong and kind == "scaled":
            pose[:3, :3] *= 1.05
        return {"arm": pose}, {"arm": at_s}, is_latched

    def _measure(self, now_s: float) -> None:
        if now_s >= self._reset_s + RESET_EVERY_S:
            self._reset_s = now_s
            self.monitor.reset()
        poses, poses_s, is_wrong = self._robot(now_s)
        said = self.monitor.measure(poses, now_s, poses_s)
        trouble = "" if not is_wrong and self._is_calm(now_s - START_S) else self._trouble_in_words()
        self._judge.look(said, self._people_m(now_s), world_T_arm(now_s), now_s, trouble)

    def _trouble_in_words(self) -> str:
        return self._trouble.kind if self._trouble else "the robot"

    def _is_calm(self, now_s: float) -> bool:
        """Nothing is wrong, and has not been for as long as it takes until that is known, and a reset after it."""
        trouble = self._trouble
        wait_s = FOUND_S + 2 * RESET_EVERY_S + 1.0
        begun = now_s > wait_s
        return begun and (
            trouble is None or not trouble.begin_s <= now_s <= max(trouble.end_s, trouble.begin_s) + wait_s
        )

    def _people_m(self, now_s: float) -> np.ndarray:
        number = self.visitors.number(now_s)
        visit = self.visitors.of(int(number))
        if visit is None:
            return np.zeros((0, self.tracking.skeleton.n_joints, 3))
        return self._clips[visit.clip].truth_m((number - visit.first) / _RATE_HZ)


def simulate(minutes: int, seed: int) -> DistanceResult:
    """So many minutes, with a progress bar."""
    rig, config = room_rig(), fgpose.Config(online={"lag_s": 0.3}, tracking={"max_processes": 1})
    clips = made_clips(rig, _VISIT_S, _RATE_HZ, seed)
    plan = SoakPlan(clips, rig.names, _RATE_HZ, START_S, seed)
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
    return int(not result.is_good)


if __name__ == "__main__":
    sys.exit(tyro.cli(main))
