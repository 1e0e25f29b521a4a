"""Cameras that are exchanged make somebody a second time, who moves as the first does."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
import pytest

from fgpose.association.track import Tracked, TrackState
from fgpose.geometry.camera import CameraRig
from fgpose.live.tracking.agreement import CameraAgreement
from fgpose.live.tracking.seen_twice import SeenTwice
from fgpose.people_observations import Detections
from fgpose.trajectory import Estimate, Status
from fgpose_benchmarks.synthetic import CrowdMotion, ring_rig, walkers

FIRST, SECOND = ("ring_1", "ring_3"), ("ring_0", "ring_2")
# Of a joint that two cameras see.
NOISE_M = 0.02
HZ = 15.0
HALF_TURN = np.diag([-1.0, -1.0, 1.0])


@cache
def walk() -> CrowdMotion:
    return walkers((3.0, 3.0), 60.0, 2, "walks", 2)


def joints_m(person: int, time_s: float) -> np.ndarray:
    return walk().truth_m[person, round(time_s * walk().fps)]


def follow(
    watched: SeenTwice | CameraAgreement,
    everybody: Sequence[tuple[Sequence[str], int, np.ndarray]],
    from_s: float,
    to_s: float,
    still: bool = False,
) -> float:
    """Let each be seen by these cameras: who of the walkers it is, and turned how; when a camera was named first, inf:
    none was."""
    skeleton, rng = walk().skeleton, np.random.default_rng(0)
    joint, status = np.arange(skeleton.n_joints), np.full(skeleton.n_joints, Status.OBSERVED, dtype=np.int8)
    for time_s in np.arange(from_s, to_s, 1 / HZ).tolist():
        people = []
        for number, (names, person, turn) in enumerate(everybody):
            positions_m = joints_m(person, 1.0 if still else time_s) @ turn.T
            positions_m = positions_m + rng.normal(0, NOISE_M, positions_m.shape)
            seen = {name: (np.zeros(len(joint), dtype=int), joint) for name in names}
            estimate = Estimate(skeleton, 0, time_s, positions_m, status)
            people.append(Tracked(number, TrackState.CONFIRMED, estimate, seen))
        names = {name for each in everybody for name in each[0]}
        empty = np.zeros((0, len(joint)))
        watched.add([Detections(name, time_s, np.zeros((0, len(joint), 2)), empty) for name in sorted(names)], people)
        if watched.faults:
            return time_s
    return np.inf


def rig(n_cameras: int = 4) -> CameraRig:
    return ring_rig(n_cameras, 6.0, 2.5, (0.0, 0.0, 0.9), focal_px=850.0, size_px=(1600, 1200))


def test_cameras_of_somebody_who_is_seen_twice_are_named_until_they_see_somebody_together() -> None:
    """Of two cameras each nobody can tell which are exchanged."""
    watched, one, double = SeenTwice(rig()), np.eye(3), HALF_TURN
    noticed_s = follow(watched, [(FIRST, 0, one), (SECOND, 0, double)], 0.0, 30.0)
    assert 8.0 <= noticed_s <= 10.0
    assert set(watched.faults) == {*FIRST, *SECOND}
    assert "moves as somebody else does" in watched.faults["ring_0"]
    together = [((*FIRST, *SECOND), 0, one)]
    follow(watched, together, noticed_s + 0.1, noticed_s + 0.2)
    for after_s in np.arange(noticed_s + 0.2, noticed_s + 7.9, 0.1).tolist():
        assert follow(watched, together, after_s, after_s + 0.1) < np.inf
    for after_s in np.arange(noticed_s + 7.9, noticed_s + 8.5, 0.1).tolist():
        follow(watched, together, after_s, after_s + 0.1)
    assert watched.faults == {}


def test_a_moment_in_which_both_are_taken_for_one_changes_nothing() -> None:
    """As where they cross."""
    watched, both = SeenTwice(rig()), [(FIRST, 0, np.eye(3)), (SECOND, 0, HALF_TURN)]
    assert follow(watched, both, 0.0, 5.0) == np.inf
    assert follow(watched, [((*FIRST, "ring_0"), 0, np.eye(3)), (SECOND, 0, HALF_TURN)], 5.0, 6.0) == np.inf
    assert follow(watched, both, 6.0, 30.0) <= 11.0


def test_the_fewer_cameras_are_blamed() -> None:
    watched = SeenTwice(rig(5))
    both = [(("ring_1", "ring_3", "ring_4"), 0, np.eye(3)), (SECOND, 0, HALF_TURN)]
    assert follow(watched, both, 0.0, 30.0) < 10.0
    assert set(watched.faults) == set(SECOND)


@pytest.mark.parametrize(
    ("first", "second", "person"),
    [
        (FIRST, SECOND, 1),  # two people, each hidden from two cameras
        (FIRST, ("ring_2",), 0),  # a reflection in one
        (FIRST, ("ring_2", "ring_3"), 0),  # and in two, in one of which somebody is seen beside it
    ],
)
def test_nobody_else_is_blamed(first: tuple[str, ...], second: tuple[str, ...], person: int) -> None:
    assert follow(SeenTwice(rig()), [(first, 0, np.eye(3)), (second, person, HALF_TURN)], 0.0, 59.0) == np.inf


def test_of_those_who_stand_still_nothing_is_known() -> None:
    both = [(FIRST, 0, np.eye(3)), (SECOND, 0, HALF_TURN)]
    assert follow(SeenTwice(rig()), both, 0.0, 59.0, still=True) == np.inf
