"""What happens in each minute of the soak of the live system, by a seed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeGuard, get_args

import numpy as np

from live_soak_consumer import ConsumerFault
from simulated_cameras import CameraFaultKind, PlayedFault
from simulated_visitors import SimulatedClip, Visit

KINDS = (*get_args(CameraFaultKind), "tracker", "estimator", *get_args(ConsumerFault))
"""In the order in which they come, a minute each. tracker: it raises. estimator: a process of estimators is killed."""
_LONG_PAUSE = 30, 60
"""Minutes of each hour in which nobody comes: longer than people who were lost are remembered."""
_IN_VISIT_SHARE = 0.75
_N_OF_WORKER = 2


@dataclass(frozen=True)
class Trouble:
    """A fault; times are seconds since the start."""

    kind: str
    cameras: tuple[str, ...]
    begin_s: float
    end_s: float
    fault: PlayedFault | None
    """None: it is not of a camera."""


class SoakPlan:
    """A visit in most minutes, and in each a fault, three of four while somebody is there.

    Args:
        clips: of the visits.
        camera_names: of which one has the fault.
        rate_hz: of the cameras.
        start_s: Unix time.
        seed: every minute is drawn by it and its number.
        kinds: of faults, in turn; none: nothing happens, and the clips come in turn.
    """

    def __init__(
        self,
        clips: Sequence[SimulatedClip],
        camera_names: Sequence[str],
        rate_hz: float,
        start_s: float,
        seed: int,
        kinds: Sequence[str] = KINDS,
    ) -> None:
        self._clips, self._names, self._rate_hz = clips, tuple(camera_names), rate_hz
        self._start_s, self._seed, self._kinds = start_s, seed, tuple(kinds)

    def visit(self, minute: int) -> Visit | None:
        """Who comes."""
        if not self._kinds:
            return Visit(minute % len(self._clips), self._image(60.0 * minute + 8.0))
        if _LONG_PAUSE[0] <= minute % 60 < _LONG_PAUSE[1]:
            return None
        rng = np.random.default_rng([self._seed, 0, minute])
        n_people = [clip.scene.motion.n_people for clip in self._clips]
        # Only who comes second is estimated in another process.
        may_come = [k for k, n in enumerate(n_people) if n > 1 or self._kind(minute) != "estimator"]
        return Visit(int(rng.choice(may_come)), self._image(60.0 * minute + float(rng.uniform(5, 15))))

    def trouble(self, minute: int) -> Trouble | None:
        """What happens."""
        if not self._kinds:
            return None
        rng, kind, visit = np.random.default_rng([self._seed, 1, minute]), self._kind(minute), self.visit(minute)
        if visit is not None and (rng.random() < _IN_VISIT_SHARE or kind == "estimator"):
            begin_s = visit.first / self._rate_hz + float(rng.uniform(3.0, 5.0))
        else:
            begin_s = 60.0 * minute + float(rng.uniform(30.0, 40.0))
        duration_s = float(rng.uniform(1.5, 3.0))
        seed = int(rng.integers(1 << 30))
        if not _is_of_camera(kind):
            return Trouble(kind, (), begin_s, begin_s, None)
        n = _N_OF_WORKER if kind == "worker" else 1
        cameras = tuple(rng.choice(self._names, n, replace=False).tolist())
        end_s = begin_s if kind == "clock" else begin_s + duration_s
        fault = PlayedFault(kind, cameras, self._start_s + begin_s, self._start_s + end_s, seed)
        return Trouble(kind, cameras, begin_s, end_s, fault)

    def _kind(self, minute: int) -> str:
        return self._kinds[minute % len(self._kinds)]

    def _image(self, at_s: float) -> int:
        return round(at_s * self._rate_hz)


def _is_of_camera(kind: str) -> TypeGuard[CameraFaultKind]:
    return kind in get_args(CameraFaultKind)
