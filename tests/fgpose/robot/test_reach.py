"""Joints without a place: the distance allows for as far as bones reach from the others, and is always a number."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from fgpose.geometry.camera import CameraRig
from fgpose.live.frame import LivePerson
from fgpose.live.tracking.observed import Volume
from fgpose.robot.body import Body
from fgpose.robot.cell import Capsule, Cell, Limits, Link
from fgpose.robot.distances import DistanceMonitor
from fgpose.robot.reach import LONGEST_M, Reach
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Status
from tests.fgpose.live.live_frames import live_frame, live_person, standing_m

NOW_S = 1000.0
POST = Link("post", (Capsule((0.0, 0.0, 0.5), (0.0, 0.0, 1.2), 0.1),), is_fixed=True)
CELL = Cell((POST,), volume=Volume((-1.0, -1.0, 0.2), (1.0, 1.0, 1.8)))


def without(person: LivePerson, skeleton: Skeleton, missing: tuple[str, ...], predicted: tuple[str, ...]) -> LivePerson:
    positions_m, status = person.positions_m.copy(), person.status.copy()
    status[[skeleton.index(joint) for joint in predicted]] = Status.PREDICTED
    for joint in missing:
        positions_m[skeleton.index(joint)], status[skeleton.index(joint)] = np.nan, Status.UNOBSERVABLE
    return replace(person, positions_m=positions_m, status=status)


def post_of(rig: CameraRig, skeleton: Skeleton, *people: LivePerson, cell: Cell = CELL):
    monitor = DistanceMonitor(cell, rig, skeleton)
    monitor.publish(live_frame(skeleton, people, NOW_S, cameras=rig.names))
    return monitor.measure({}, NOW_S)[0]


def test_somebody_far_away_without_an_elbow_hides_nobody(rig: CameraRig, skeleton: Skeleton) -> None:
    """Their wrist is predicted and was never observed; somebody else is at the post."""
    near = live_person(standing_m(skeleton, (0.3, 0.0)), 1)
    far = without(live_person(standing_m(skeleton, (-3.0, 0.0)), 2), skeleton, ("left_elbow",), ("left_wrist",))
    alone, both = post_of(rig, skeleton, near), post_of(rig, skeleton, near, far)
    assert (both.distance_m, both.expected_m, both.person) == (alone.distance_m, alone.expected_m, 1)
    assert both.fault is None


def test_an_arm_without_a_place_may_be_where_bones_reach(rig: CameraRig, skeleton: Skeleton) -> None:
    whole = live_person(standing_m(skeleton, (3.0, 0.0)))
    arm = without(whole, skeleton, ("left_elbow", "left_wrist"), ())
    said = post_of(rig, skeleton, arm)
    assert said.fault is None  # it is farther away than missing_within_m
    # The left hand, from the left shoulder 2.8 m from the axis of the post and 0.2 m above its end.
    reach_m = LONGEST_M["upper_arm"] + LONGEST_M["lower_arm"]
    assert said.part == "left hand"
    assert said.distance_m == pytest.approx(math.hypot(2.8, 0.2) - 0.1 - 0.21 - reach_m)
    assert said.expected_m == pytest.approx(math.hypot(2.8, 0.2) - 0.1 - 0.21)
    # What is true of a hand that is stretched out towards the post.
    reaching_m = whole.positions_m.copy()
    shoulder_m = reaching_m[skeleton.index("left_shoulder")]
    reaching_m[skeleton.index("left_elbow")] = shoulder_m - (0.37, 0.0, 0.0)
    reaching_m[skeleton.index("left_wrist")] = shoulder_m - (0.66, 0.0, 0.0)
    assert said.distance_m < post_of(rig, skeleton, live_person(reaching_m)).distance_m


@pytest.mark.parametrize("at_m", [(0.4, 0.0), (1.5, 0.3), (3.0, 1.0)])
def test_whatever_is_missing_no_distance_is_larger_than_the_truth(
    rig: CameraRig, skeleton: Skeleton, at_m: tuple[float, float]
) -> None:
    random = np.random.default_rng(5)
    whole = live_person(standing_m(skeleton, at_m), sigma_m=0.01)
    truth_m = post_of(rig, skeleton, live_person(whole.positions_m)).distance_m
    for _ in range(40):
        kind = random.choice(3, skeleton.n_joints, p=random.dirichlet(np.ones(3)))
        missing, predicted = (
            tuple(itertools.compress(skeleton.joints, (kind == number).tolist())) for number in (1, 2)
        )
        said = post_of(rig, skeleton, without(whole, skeleton, missing, predicted))
        assert not math.isnan(said.distance_m)
        assert said.distance_m <= truth_m


def test_where_no_joint_has_a_place_everything_is_possible(rig: CameraRig, skeleton: Skeleton) -> None:
    nowhere = without(live_person(standing_m(skeleton)), skeleton, skeleton.joints, ())
    said = post_of(rig, skeleton, live_person(standing_m(skeleton, (3.0, 0.0))), nowhere)
    assert said.distance_m == -math.inf
    assert said.fault is not None


def test_a_distance_that_is_no_number_is_one_that_may_be_anything(
    rig: CameraRig, skeleton: Skeleton, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever is wrong in between: here the bound of an arm."""
    monkeypatch.setattr(Reach, "places", _with_nan(Reach.places))
    said = post_of(rig, skeleton, live_person(standing_m(skeleton, (3.0, 0.0)), 4))
    assert said.distance_m == -math.inf
    assert said.fault is not None
    assert said.fault.reason == "person 4 may be anywhere"


def _with_nan(places):
    def with_nan(reach, frame, away_m):
        found = places(reach, frame, away_m)
        covariance_m2 = found.covariance_m2.copy()
        covariance_m2[:, 0] = np.nan
        return replace(found, covariance_m2=np.full_like(covariance_m2, np.nan))

    return with_nan


def test_bones_add_up(skeleton: Skeleton) -> None:
    """From the left wrist to the right ankle by the trunk, whatever the pose."""
    body = Body.of(skeleton)
    places = Reach(body, skeleton.n_joints).places
    wrist = np.full((skeleton.n_joints, 3), np.nan)
    wrist[skeleton.index("left_wrist")] = 0.0
    away_m = np.where(np.isfinite(wrist).all(axis=-1), 0.0, np.inf)[None]
    found = places(live_frame(skeleton, (live_person(wrist),)), away_m)
    far_m = sum(LONGEST_M[part] for part in ("lower_arm", "upper_arm", "trunk", "upper_leg", "lower_leg"))
    assert found.away_m[0, skeleton.index("right_ankle")] == pytest.approx(far_m)
    assert LONGEST_M.keys() == {part for part, (a, b) in zip(body.parts, body.joints, strict=True) if set(a) != set(b)}
    assert Limits().missing_within_m > LONGEST_M["upper_arm"] + LONGEST_M["lower_arm"]
