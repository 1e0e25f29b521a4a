"""What goes wrong in the storm, by a seed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

GROUPS = {
    "camera": ("drops out", "freezes", "late", "stalls", "slow", "reconnects", "shuffled", "source fails"),
    "clock": ("set", "jumps", "drifts", "stamps ahead"),
    "messages": ("second sender", "copies ahead", "says nobody", "wrong people", "garbage", "flood", "poison"),
    "tracker": ("fails", "fails again", "tidying fails", "tracking fails", "hangs", "estimator ends"),
    "processes": ("stopped", "cameras end", "output raises"),
    "robot": (
        "robot stops",
        "robot late",
        "robot ahead",
        "robot scaled",
        "robot flood",
        "second robot",
        "robot garbage",
        "robot pauses",
    ),
}
"""Kinds of faults that begin and end. One of all kinds is as likely as another one.

stalls: images come together when it is over. shuffled: some come twice, some after later ones. set: a clock begins in
1970 and is set. copies ahead: another one sends images of 2 s ago with stamps that are ahead. poison: messages that are
right by the schema and wrong in everything else. stopped: the whole process, as by SIGSTOP.
"""
FROM_THE_START = ("late from the start", "behind from the start")
"""As long as a session lasts, a camera's images, or its clock."""
SOURCES = ("device", "stream", "synchronised", "auto", "own")
"""What a camera is: of this computer, or a stream without Unix time; the others are detectors, by their clocks."""
_KIND_OF_CLUSTER = (0.5, 0.3, 0.2)
_APART_S, _LASTS_S, _BEGINS_S = 15.0, (0.1, 3.0), 8.0
_SHARE_FROM_THE_START = 0.25


@dataclass(frozen=True)
class PlannedFault:
    """Times are Unix time."""

    kind: str
    cameras: tuple[str, ...]
    begin_s: float
    end_s: float
    amount: float
    """0 to 1."""


@dataclass(frozen=True)
class StormSession:
    """From a start of the live system to its end."""

    sources: dict[str, str]
    """Of each camera."""
    robot_says_times: bool
    start: dict[str, tuple[str, float]]
    """Cameras that have a fault from the start, and how much of it in seconds."""
    faults: tuple[PlannedFault, ...]


def session(names: tuple[str, ...], begin_s: float, duration_s: float, rng: np.random.Generator) -> StormSession:
    """A session with faults one to three at a time."""
    sources = {name: str(rng.choice(SOURCES)) for name in names}
    start = {}
    if rng.random() < _SHARE_FROM_THE_START:
        name = str(rng.choice(names))
        start[name] = str(rng.choice(FROM_THE_START)), float(rng.uniform(0.2, 3.0))
    faults, kinds = [], [kind for group in GROUPS.values() for kind in group]
    at_s = begin_s + _BEGINS_S + float(rng.uniform(0, _APART_S))
    while at_s < begin_s + duration_s - _BEGINS_S:
        for _ in range(1 + int(rng.choice(len(_KIND_OF_CLUSTER), p=_KIND_OF_CLUSTER))):
            fault_s = at_s + float(rng.uniform(0, 1.0))
            cameras = tuple(rng.choice(names, int(rng.choice((1, 1, 2, len(names)))), replace=False).tolist())
            lasts_s = float(np.exp(rng.uniform(*np.log(_LASTS_S))))
            faults.append(
                PlannedFault(str(rng.choice(kinds)), cameras, fault_s, fault_s + lasts_s, float(rng.random()))
            )
        at_s += _APART_S + float(rng.exponential(_APART_S))
    return StormSession(sources, bool(rng.random() < 0.5), start, tuple(faults))
