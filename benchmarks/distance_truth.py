"""Distances that a monitor says, against the truth."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field

import numpy as np
from jaxtyping import Float

from fgpose.association.track import TrackState
from fgpose.geometry.camera import CameraRig
from fgpose.live.frame import LiveFrame, LivePerson
from fgpose.live.link_distance import LinkDistance
from fgpose.robot.assurance import FOUND_S
from fgpose.robot.cell import Capsule, Cell, Limits, Link
from fgpose.robot.distances import DistanceMonitor
from fgpose.skeleton import Skeleton

CELL = Cell(
    (
        Link("arm", (Capsule((0.0, 0.0, 0.0), (0.0, 0.0, 0.4), 0.08),)),
        Link("table", (Capsule((0.8, 0.0, 0.4), (0.8, 0.0, 0.9), 0.3),), is_fixed=True),
    ),
    Limits(min_observed_share=0.5, lost_s=0.01),
)
"""A robot and something that stands in the room. Visits end in the midst of it: nobody who is lost is remembered."""
RESET_EVERY_S = 1.0
"""An operator resets the faults so often."""
ROBOT_M_S = 0.5
SILENCE_S = 0.3
"""Longer is a fault."""
# Positions are interpolated between frames of motion capture, and joints are not the surface.
_TOLERANCE_M = 0.02
_N_WORST = 50


@dataclass
class DistanceResult:
    """Of what was simulated so far."""

    n_sessions: int = 0
    hours: float = 0.0
    n_faults: int = 0
    faults: dict[str, int] = field(default_factory=dict)
    """Of these, by kind."""
    n_said: int = 0
    """Distances without a fault while somebody was there."""
    n_too_large: int = 0
    largest_m: float = -math.inf
    """By how much one was larger than the truth."""
    n_nobody: int = 0
    """Of these, nobody while somebody was there."""
    worst: dict[str, float] = field(default_factory=dict)
    """By what was wrong: by how much one was larger, at most."""
    n_calm: int = 0
    """Distances while nothing was wrong."""
    n_calm_said: int = 0
    """Of these, without a fault."""
    reasons: dict[str, int] = field(default_factory=dict)
    """Of faults while nothing was wrong."""
    longest_silence_s: float = 0.0
    """Without a frame, while the process ran and the tracker answered."""

    @property
    def too_large(self) -> float:
        return self.n_too_large / max(self.n_said, 1)

    @property
    def availability(self) -> float:
        return self.n_calm_said / max(self.n_calm, 1)

    @property
    def is_good(self) -> bool:
        """No more are larger than the truth than their quantile allows, and there is no silence."""
        return self.too_large <= 1 - CELL.limits.quantile and self.longest_silence_s <= SILENCE_S

    def add(self, other: DistanceResult) -> None:
        """What was simulated elsewhere."""
        for name in asdict(other):
            own, value = getattr(self, name), getattr(other, name)
            if name == "worst":
                own.update({trouble: max(over_m, own.get(trouble, -math.inf)) for trouble, over_m in value.items()})
            elif isinstance(value, dict):
                own.update(Counter(own) + Counter(value))
            else:
                setattr(self, name, max(own, value) if name in ("largest_m", "longest_silence_s") else own + value)


class Judge:
    """Compares, and counts.

    Args:
        rig, skeleton: of the frames.
        result: to which it is added.
    """

    def __init__(self, rig: CameraRig, skeleton: Skeleton, result: DistanceResult) -> None:
        self._monitor, self._skeleton, self.result = DistanceMonitor(CELL, rig, skeleton), skeleton, result
        self._there_since_s: dict[int, float] = {}
        self._reasons = Counter(result.reasons)

    def look(
        self,
        said: Sequence[LinkDistance],
        people_m: Float[np.ndarray, "person joint 3"],
        world_T_arm: Float[np.ndarray, "4 4"],
        now_s: float,
        trouble: str,
    ) -> None:
        """Take what is said at a time.

        Args:
            said: of the links of CELL.
            people_m: where everybody is; NaN: not there. Who appears out of nowhere counts after a second, as nobody
                walks into a room so.
            world_T_arm: where the robot is.
            now_s: Unix time.
            trouble: what is wrong, in words; empty: nothing.
        """
        there = np.flatnonzero(np.isfinite(people_m).all(axis=(1, 2))).tolist()
        self._there_since_s = {who: self._there_since_s.get(who, now_s) for who in there}
        if not trouble:
            self.result.n_calm += len(said)
            self.result.n_calm_said += sum(each.fault is None for each in said)
            self._reasons.update(each.fault.reason[:60] for each in said if each.fault is not None)
            self.result.reasons = dict(self._reasons.most_common(10))
        there = [who for who in there if now_s - self._there_since_s[who] > FOUND_S]
        if there and any(each.fault is None for each in said):
            true_m = self._true_m(people_m[there], world_T_arm, now_s)
            for each in said:
                self._compare(each, true_m[each.link], trouble)

    def _compare(self, said: LinkDistance, true_m: float, trouble: str) -> None:
        if said.fault is not None:
            return
        self.result.n_said += 1
        # Links are taken to be where they were when their pose was.
        over_m = said.distance_m - true_m - (ROBOT_M_S * max(said.pose_age_s, 0.0) if said.link == "arm" else 0.0)
        self.result.largest_m = max(self.result.largest_m, over_m)
        if over_m > _TOLERANCE_M:
            self.result.n_too_large += 1
            self.result.n_nobody += math.isinf(said.distance_m)
            if len(self.result.worst) < _N_WORST or trouble in self.result.worst:
                self.result.worst[trouble] = max(self.result.worst.get(trouble, 0.0), over_m)

    def _true_m(
        self, people_m: Float[np.ndarray, "person joint 3"], world_T_arm: Float[np.ndarray, "4 4"], now_s: float
    ) -> dict[str, float]:
        """Distance of each link from the nearest."""
        people = tuple(_exactly(who, joints_m) for who, joints_m in enumerate(people_m))
        frame = LiveFrame(0, now_s, now_s, self._skeleton, people, (), 1.0, now_s - 60.0)
        poses = np.stack([world_T_arm if link.name == "arm" else np.eye(4) for link in CELL.links])
        places = self._monitor._reach.places(frame, np.zeros(people_m.shape[:2]))
        expected_m = self._monitor._measured(places, poses, 0.0).expected_m.min(axis=(0, 1))
        return {link.name: float(each_m) for link, each_m in zip(CELL.links, expected_m, strict=True)}


def world_T_arm(at_s: float) -> Float[np.ndarray, "4 4"]:
    """Of a robot that moves in a circle."""
    pose = np.eye(4)
    angle = at_s % (4 * math.pi)
    pose[:3, 3] = ROBOT_M_S * math.cos(angle), ROBOT_M_S * math.sin(angle), 0.9
    return pose


def _exactly(who: int, joints_m: np.ndarray) -> LivePerson:
    n = len(joints_m)
    return LivePerson(
        who, TrackState.CONFIRMED, joints_m, np.tile(1e-12 * np.eye(3), (n, 1, 1)), np.full(n, 2), np.ones(n)
    )
