"""Frames as a live system publishes them, of two people whose pose says when it was."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable

import numpy as np

from fgpose.association.track import TrackState
from fgpose.live.frame import CameraState, CameraStatus, LiveFrame, LivePerson
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Status

SKELETON = Skeleton(
    "stick",
    ("pelvis", "left_knee", "left_ankle", "neck"),
    bones=((0, 1), (1, 2), (0, 3)),
    root=(0,),
    lines=((1, 3),),
)
PATIENCE_S = 600.0
"""After so long nothing comes any more, whatever else the computer has to do."""
START_S = 1.75e9
"""Unix time of frame 0; frames come with 30 Hz."""


def person(number: int, sequence: int, *, unknown: tuple[int, ...] = (2,)) -> LivePerson:
    """Somebody at x = number, and at y = 1 cm times the sequence number; some joints are unknown. Who is called 4 may
    be somebody else, and who is called 7 was called 2."""
    n_joints = SKELETON.n_joints
    positions_m = np.tile([float(number), 0.01 * sequence, 0.0], (n_joints, 1))
    positions_m[:, 2] = 0.5 * np.arange(n_joints)
    positions_m[list(unknown)] = np.nan
    root = np.random.default_rng(number).normal(size=(n_joints, 3, 3))
    covariance_m2 = 1e-4 * root @ root.swapaxes(1, 2)
    covariance_m2[list(unknown)] = np.nan
    status = np.where(np.isnan(positions_m[:, 0]), Status.UNOBSERVABLE, Status.OBSERVED)
    probability, former = np.linspace(0.2, 0.9, n_joints), 2 if number == 7 else None
    return LivePerson(
        number, TrackState.CONFIRMED, positions_m, covariance_m2, status, probability, number == 4, former
    )


def frame(sequence: int, people: tuple[int, ...] = (4, 7)) -> LiveFrame:
    """Frame of a number; the newest image is 40 ms old."""
    published_s = START_S + sequence / 30
    cameras = (
        CameraStatus("cam_1", CameraState.OK, "", published_s - 0.04, 30.0, 0.012, 0.001, 90, 88, 1),
        CameraStatus("cam_2", CameraState.LOST, "no image for 3 s"),
    )
    seen = tuple(person(number, sequence) for number in people)
    return LiveFrame(sequence, published_s - 0.04, published_s, SKELETON, seen, cameras, 0.75)


def assert_same_frame(actual: LiveFrame, expected: LiveFrame) -> None:
    """To the single precision of messages: 1e-7 of the size."""
    scalars = ("sequence", "time_s", "published_s", "observed_share", "cameras", "skeleton")
    assert [getattr(actual, name) for name in scalars] == [getattr(expected, name) for name in scalars]
    assert [(each.person, each.state, each.is_provisional, each.former) for each in actual.people] == [
        (each.person, each.state, each.is_provisional, each.former) for each in expected.people
    ]
    for a, b in zip(actual.people, expected.people, strict=True):
        np.testing.assert_array_equal(a.status, b.status)
        for name in ("positions_m", "covariance_m2", "probability"):
            np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=1e-7)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def wait_until(condition: Callable[[], object]) -> None:
    """Fails if it does not come true in much more time than a loaded computer takes."""
    end_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end_s, "it has not come true"
        time.sleep(0.005)
