"""People who were very near each other: whether they may be exchanged is said, and put right where bones tell."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
import pytest
from rooms import FPS, body_m, image, people_of, run

import fgpose
from fgpose.association.follow import Follower
from fgpose.association.recording import Association, associate
from fgpose.finding import Code
from fgpose.geometry.camera import CameraRig
from fgpose.people_observations import PeopleObservations
from fgpose.skeleton import Skeleton

END_S = 14.0
MOMENTS_S, APART_M = (2.4, 4.0, 7.0, 8.6), 2.0
"""When they begin to come, have come, begin to go and have gone, without a jerk: at 0.9 m/s each at most."""


@dataclass(frozen=True)
class Hug:
    """Two who come to each other and stand there for three seconds."""

    skeleton: Skeleton
    least_m: float
    sizes: tuple[float, float] = (1.0, 1.0)
    exchanged_s: float = np.inf
    """When they change sides, which nobody sees."""

    def __call__(self, camera: int, time_s: float) -> list[np.ndarray]:
        nearness = 0.5 - 0.5 * np.cos(np.pi * np.interp(time_s, MOMENTS_S, (0.0, 1.0, 1.0, 0.0)))
        distance_m = APART_M + nearness * (self.least_m - APART_M)
        side_m = distance_m / 2 if time_s < self.exchanged_s else -distance_m / 2
        places_m = (0.0, -side_m), (0.0, side_m)
        return [body_m(self.skeleton, at, size) for at, size in zip(places_m, self.sizes, strict=True)]


def doubts(follower: Follower) -> list[tuple[str, int, int | None]]:
    return [(event.what, event.person, event.beside) for event in follower.events if event.beside is not None]


def provisional(follower: Follower, now_s: float) -> list[int]:
    return sorted(track.person for track in follower.tracks if follower.is_provisional(track, now_s))


def of_recording(hug: Hug, rig: CameraRig) -> Association:
    rng = np.random.default_rng(0)
    images = [
        image(rig, c, frame / FPS, hug(c, frame / FPS), rng)
        for frame in range(round(END_S * FPS))
        for c in range(rig.n_cameras)
    ]
    return associate(PeopleObservations(hug.skeleton, rig.names, tuple(images)), rig)


@pytest.fixture
def follower(rig: CameraRig, skeleton: Skeleton) -> Follower:
    return Follower(rig, skeleton)


def test_of_two_alike_who_embrace_it_stays_open_who_is_who(
    follower: Follower, rig: CameraRig, skeleton: Skeleton
) -> None:
    hug = Hug(skeleton, least_m=0.2)
    run(follower, rig, hug, 0.0, 3.2)
    assert provisional(follower, 3.2) == []
    run(follower, rig, hug, 3.2, 6.9)
    assert provisional(follower, 6.9) == [0, 1]
    run(follower, rig, hug, 6.9, END_S)
    assert doubts(follower) == [("perhaps exchanged", 0, 1), ("perhaps exchanged", 1, 0)]
    event = next(event for event in follower.events if event.beside == 1)
    begin_s, end_s = (float(word) for word in re.findall(r"(\d+\.\d) ", event.reason)[:2])
    # Half a second before they stand still they are 0.6 m apart, and 0.8 s after it 1.1 m.
    assert 3.5 < begin_s < 4.0
    assert 7.0 < end_s < 7.8
    # Nothing tells them apart later.
    assert provisional(follower, END_S) == [0, 1]


def test_it_is_said_of_who_is_lost_or_still_there_in_the_end(
    follower: Follower, rig: CameraRig, skeleton: Skeleton
) -> None:
    run(follower, rig, Hug(skeleton, least_m=0.2), 0.0, 6.9)
    assert doubts(follower) == []
    follower.finish()
    assert doubts(follower) == [("perhaps exchanged", 0, 1), ("perhaps exchanged", 1, 0)]


@pytest.mark.parametrize("seed", range(3))
def test_nothing_is_said_of_two_half_a_metre_apart(
    follower: Follower, rig: CameraRig, skeleton: Skeleton, seed: int
) -> None:
    run(follower, rig, Hug(skeleton, least_m=0.5), 0.0, END_S, seed)
    assert doubts(follower) == []
    assert people_of(follower) == [0, 1]


def test_nothing_is_said_of_two_who_pass_each_other(follower: Follower, rig: CameraRig, skeleton: Skeleton) -> None:
    """At 1.2 m/s each, shoulder to shoulder."""

    def scene(camera: int, time_s: float) -> list[np.ndarray]:
        x_m = 1.2 * (time_s - 1.5)
        return [body_m(skeleton, (x_m, 0.17)), body_m(skeleton, (-x_m, -0.17))]

    run(follower, rig, scene, 0.0, 3.0)
    assert doubts(follower) == []
    assert people_of(follower) == [0, 1]


@pytest.mark.parametrize(("exchanged_s", "settled"), [(np.inf, "not exchanged"), (5.5, "exchanged")])
def test_bones_tell_later_whether_two_were_exchanged(
    follower: Follower, rig: CameraRig, skeleton: Skeleton, exchanged_s: float, settled: str
) -> None:
    hug = Hug(skeleton, 0.2, (1.0, 0.9), exchanged_s)
    run(follower, rig, hug, 0.0, END_S)
    (first, again) = doubts(follower)[::2]
    assert (first, again) == (("perhaps exchanged", 0, 1), (settled, 0, 1))
    assert provisional(follower, END_S) == []


@pytest.mark.parametrize("exchanged_s", [np.inf, 5.5])
def test_who_was_exchanged_has_the_right_number_in_a_recording(
    rig: CameraRig, skeleton: Skeleton, exchanged_s: float
) -> None:
    association = of_recording(Hug(skeleton, 0.2, (1.0, 0.9), exchanged_s), rig)
    assert len(association.people) == 2
    for seen in association.people.values():
        own = seen.main_detection
        before, after = own[: round(3.5 * FPS)], own[round(7.5 * FPS) :]
        assert (before == before[0, 0]).all()
        assert (after == before[0, 0]).all()
    # Nothing is said of what turned out to be right.
    assert {event.what for event in association.events} - {"confirmed"} == (
        {"exchanged"} if exchanged_s < END_S else set()
    )


@pytest.mark.slow
def test_the_diagnosis_says_who_may_have_been_exchanged(rig: CameraRig, skeleton: Skeleton) -> None:
    association = of_recording(Hug(skeleton, 0.2), rig)
    result = fgpose.smooth_people(association.observations, rig)
    found = fgpose.diagnose(association, rig, result.trajectories).findings
    assert [finding.person for finding in found if finding.code is Code.PERHAPS_EXCHANGED] == [0]
