"""A camera of the storm with its detector, and everything that may be wrong with it."""

from __future__ import annotations

import math

import numpy as np

from fgpose.geometry.camera import Camera
from fgpose.live.sources import CameraSource
from fgpose.people_observations import Detections
from storm_plan import PlannedFault

MOST_CONNECTIONS = 500
"""Of cameras; others have larger numbers."""
# From taking an image to its arrival: at least, and on average as much more.
_LATENCY_S, _JITTER_S = (0.02, 0.04), 0.005
_CLOCK_SIGMA_S, _CRYSTAL = 0.003, 20e-6
_OWN_CLOCKS = "own", "stream"


class StormCamera:
    """A camera with its detector, at the far end of the network or here.

    Args:
        camera: as in the rig.
        source: one of storm_plan.SOURCES.
        start: fault from the start and how much of it; empty: none.
        rng: of its clock and delays.
    """

    def __init__(self, camera: Camera, source: str, start: tuple[str, float] | None, rng: np.random.Generator) -> None:
        self.camera, self.source, self._rng = camera, source, rng
        self._least_s = float(rng.uniform(*_LATENCY_S))
        self.connection = int(rng.integers(MOST_CONNECTIONS))
        kind, much_s = start or ("", 0.0)
        self.late_s = much_s if kind == "late from the start" and source not in _OWN_CLOCKS else 0.0
        own_s = float(rng.uniform(-1e5, 1e5)) if source in _OWN_CLOCKS else float(rng.normal(0, _CLOCK_SIGMA_S))
        self._offset_s = own_s - (much_s if kind == "behind from the start" else 0.0)
        self._drift = float(rng.uniform(-_CRYSTAL, _CRYSTAL)) if source in _OWN_CLOCKS else 0.0
        self.faults: dict[str, PlannedFault] = {}
        self.frozen: Detections | None = None
        self.arrival_s = -math.inf

    def settings(self) -> CameraSource:
        """As a rig file would say it: the truth."""
        latency_s = self._least_s if self.source in _OWN_CLOCKS else 0.0
        clock = self.source if self.source in ("synchronised", "own") else "auto"
        return CameraSource("zmq" if self.is_detector else "simulated", latency_s=latency_s, clock=clock)

    @property
    def is_detector(self) -> bool:
        return self.source in ("synchronised", "auto", "own")

    def stamp_s(self, taken_s: float, since_s: float) -> float:
        """By its clock, of an image that is taken at a Unix time, so long after the start."""
        stamp_s = taken_s + self._offset_s + self._drift * since_s
        for fault in self.faults.values():
            if fault.kind == "set":
                stamp_s -= 1.7e9
            elif fault.kind == "jumps":
                stamp_s += (0.5 + 4.5 * fault.amount) * (1 if fault.amount < 0.5 else -1)
            elif fault.kind == "stamps ahead":
                stamp_s += 0.15 + fault.amount
            elif fault.kind == "drifts":
                # Whoever says that a clock is synchronised says that it does not run ahead.
                sign = 1 if self.source in _OWN_CLOCKS and fault.amount < 0.5 else -1
                stamp_s += sign * 0.1 * fault.amount * (taken_s - fault.begin_s)
        return stamp_s

    def arrives_s(self, taken_s: float) -> float:
        """When an image comes; NaN: never."""
        arrival_s = taken_s + self._least_s + float(self._rng.exponential(_JITTER_S)) + self.late_s
        for fault in self.faults.values():
            if fault.kind in ("drops out", "reconnects", "source fails", "cameras end"):
                return math.nan
            if fault.kind == "slow" and int(taken_s * 7.0) % 3:
                return math.nan
            if fault.kind == "late":
                arrival_s += 0.2 + 2.0 * fault.amount
            elif fault.kind == "stalls":
                arrival_s = max(arrival_s, fault.end_s)
        if "shuffled" in self.faults:
            return arrival_s + float(self._rng.uniform(0, 0.5))
        self.arrival_s = max(arrival_s, self.arrival_s + 1e-4)
        return self.arrival_s

    def found(self, seen: Detections) -> Detections:
        """What its detector says of what is seen."""
        if "freezes" in self.faults:
            self.frozen = self.frozen or seen
            return self.frozen
        self.frozen = None
        return others(seen, self._rng) if "wrong people" in self.faults else seen


def others(seen: Detections, rng: np.random.Generator) -> Detections:
    """People who are not there."""
    n_joints = seen.points2d_px.shape[1]
    return Detections(seen.camera, 0.0, rng.uniform(0, 1200, (2, n_joints, 2)), np.full((2, n_joints), 0.9))
