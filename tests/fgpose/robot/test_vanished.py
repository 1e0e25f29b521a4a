"""Who is lost near a link, where nobody leaves unseen, is a fault until they are seen again, and not nobody."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fgpose.geometry.camera import CameraRig
from fgpose.live.frame import LivePerson
from fgpose.live.link_distance import LinkDistance
from fgpose.live.tracking.observed import Volume
from fgpose.robot.body import Body
from fgpose.robot.cell import Capsule, Cell, Limits, Link
from fgpose.robot.distances import DistanceMonitor
from fgpose.robot.reach import Reach
from fgpose.robot.vanished import Remembered
from fgpose.skeleton import Skeleton
from tests.fgpose.live.live_frames import live_frame, live_person, standing_m

NOW_S, STEP_S = 1000.0, 1 / 30
NEAR = Link("near", (Capsule((0.0, 0.0, 0.5), (0.0, 0.0, 1.2), 0.1),), is_fixed=True)
FAR = Link("far", (Capsule((0.0, 4.0, 0.5), (0.0, 4.0, 1.2), 0.1),), is_fixed=True)
VOLUME = Volume((-1.5, -1.5, 0.2), (1.5, 5.0, 1.8))
LIMITS = Limits(min_observed_share=0.01)


class Watched:
    """A monitor whose faults are reset each time, as by somebody who never looks."""

    def __init__(self, rig: CameraRig, skeleton: Skeleton, volume: Volume | None = VOLUME) -> None:
        self._monitor = DistanceMonitor(Cell((NEAR, FAR), LIMITS, volume), rig, skeleton)
        self._rig, self._skeleton = rig, skeleton

    def seen(self, after_s: float, *people: LivePerson) -> list[LinkDistance]:
        """What is said of both links after a frame of these people."""
        time_s = NOW_S + after_s
        frame = live_frame(self._skeleton, people, time_s, cameras=self._rig.names)
        self._monitor.publish(replace(frame, tracking_since_s=NOW_S - 60.0))
        self._monitor.reset()
        return list(self._monitor.measure({}, time_s + 0.02))

    def faults(self, after_s: float, *people: LivePerson) -> list[bool]:
        return [distance.fault is not None for distance in self.seen(after_s, *people)]


@pytest.fixture
def watched(rig: CameraRig, skeleton: Skeleton) -> Watched:
    return Watched(rig, skeleton)


@pytest.fixture
def near(skeleton: Skeleton) -> LivePerson:
    return live_person(standing_m(skeleton, (0.6, 0.0)), 3)


def test_who_is_lost_beside_a_link_is_a_fault_of_it_for_a_time(watched: Watched, near: LivePerson) -> None:
    assert watched.faults(0.0, near) == [False, False]
    said, far = watched.seen(STEP_S)
    assert said.fault is not None
    # 0.3 m from the wrist to the surface of the link, less the hand.
    assert said.fault.reason == "person 3 was lost 0.0 m from it 0.0 s ago, and not seen again"
    assert far.fault is None  # 4 m away
    assert watched.faults(LIMITS.lost_s - 1.0) == [True, False]
    assert watched.faults(LIMITS.lost_s + 1.0) == [False, False]


def test_who_is_found_again_is_lost_no_longer(watched: Watched, near: LivePerson, skeleton: Skeleton) -> None:
    again = live_person(standing_m(skeleton, (-0.5, 0.5)), 9)
    watched.seen(0.0, near)
    assert watched.faults(STEP_S) == [True, False]
    assert watched.faults(3.0, again) == [False, False]
    assert watched.faults(3.1, again) == [False, False]


def test_who_is_recognised_is_lost_no_longer(watched: Watched, near: LivePerson, skeleton: Skeleton) -> None:
    """At the other end of the room."""
    far = live_person(standing_m(skeleton, (0.0, 3.5)), 9)
    watched.seen(0.0, near)
    assert watched.faults(3.0, far) == [True, False]
    assert watched.faults(3.1, replace(far, person=3, former=9)) == [False, False]


def test_somebody_else_is_not_who_was_lost(watched: Watched, near: LivePerson, skeleton: Skeleton) -> None:
    """Who was there before, and who comes in elsewhere and walks to the link."""
    other = live_person(standing_m(skeleton, (-0.5, 0.5)), 4)
    watched.seen(0.0, near, other)
    assert watched.faults(STEP_S, other) == [True, False]
    for step in range(40):
        coming = live_person(standing_m(skeleton, (0.0, 3.5 - 0.1 * step)), 9)
        assert watched.faults(5.0 + step / 10, other, coming)[0]


def test_of_two_who_are_lost_one_is_found_again(watched: Watched, near: LivePerson, skeleton: Skeleton) -> None:
    other = live_person(standing_m(skeleton, (-0.6, 0.0)), 4)
    watched.seen(0.0, near, other)
    watched.seen(STEP_S)
    said = watched.seen(2.0, replace(near, person=9))[0]
    assert said.fault is not None
    assert said.fault.reason.startswith("person 4 was lost")


def test_a_new_number_is_not_a_loss(watched: Watched, near: LivePerson) -> None:
    watched.seen(0.0, near)
    assert watched.faults(STEP_S, replace(near, person=1, former=3)) == [False, False]
    # Found twice: one of the two has ended.
    twice = replace(near, person=5, positions_m=near.positions_m + 0.05)
    watched.seen(2 * STEP_S, replace(near, person=1, former=3), twice)
    assert watched.faults(3 * STEP_S, twice) == [False, False]


def test_who_leaves_the_volume_has_gone(rig: CameraRig, skeleton: Skeleton) -> None:
    watched = Watched(rig, skeleton)
    watched.seen(0.0, live_person(standing_m(skeleton, (1.6, 0.0)), 3))
    assert watched.faults(STEP_S) == [False, False]


def test_who_leaves_the_view_of_two_cameras_has_gone(rig: CameraRig, skeleton: Skeleton) -> None:
    """Of the middle of the body: its upper half may be out of sight."""
    body = Body.of(skeleton)
    for at_m, is_remembered in (((0.0, 0.0, 0.0), True), ((0.0, 0.0, 0.7), True), ((0.0, 0.0, 3.5), False)):
        remembered = Remembered(rig, None, LIMITS)
        before = live_frame(skeleton, (live_person(standing_m(skeleton) + np.array(at_m)),), NOW_S, cameras=rig.names)
        places = Reach(body, skeleton.n_joints).places(before, np.zeros((1, skeleton.n_joints)))
        remembered.add(live_frame(skeleton, (), NOW_S + STEP_S, cameras=rig.names), before, places)
        assert (len(remembered.people) == 1) == is_remembered


def test_somebody_without_any_place_may_be_anywhere(watched: Watched, near: LivePerson) -> None:
    watched.seen(0.0, replace(near, positions_m=np.full_like(near.positions_m, np.nan)))
    assert watched.faults(STEP_S) == [True, True]
