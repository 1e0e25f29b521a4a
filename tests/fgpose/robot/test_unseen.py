"""How far joints may be that no two cameras see."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fgpose.live.frame import LivePerson
from fgpose.robot.cell import Limits
from fgpose.robot.unseen import Unseen
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Status
from tests.fgpose.live.live_frames import live_frame, live_person, standing_m

LIMITS = Limits()
ARM = ("left_shoulder", "left_elbow", "left_wrist")


def hidden(person: LivePerson, skeleton: Skeleton, *joints: str) -> LivePerson:
    status = person.status.copy()
    status[[skeleton.index(joint) for joint in joints]] = Status.PREDICTED
    return replace(person, status=status)


def away_m(unseen: Unseen, skeleton: Skeleton, person: LivePerson, time_s: float) -> dict[str, float]:
    of_joints = unseen.away_m(live_frame(skeleton, (person,), time_s))[0]
    return dict(zip(skeleton.joints, of_joints.tolist(), strict=True))


def test_what_is_seen_is_where_it_is_said_to_be(skeleton: Skeleton) -> None:
    unseen, person = Unseen(skeleton, LIMITS), live_person(standing_m(skeleton))
    for time_s in (0.0, 5.0):
        assert set(away_m(unseen, skeleton, person, time_s).values()) == {0.0}


def test_an_unseen_arm_moves_with_its_speed_and_no_farther_than_it_reaches(skeleton: Skeleton) -> None:
    unseen, person = Unseen(skeleton, LIMITS), live_person(standing_m(skeleton))
    away_m(unseen, skeleton, person, 0.0)
    lost = hidden(person, skeleton, "left_elbow", "left_wrist")
    soon = away_m(unseen, skeleton, lost, 0.1)
    assert soon["left_wrist"] == pytest.approx(0.1 * LIMITS.hand_m_s)
    assert soon["right_wrist"] == soon["left_shoulder"] == 0.0
    shoulder, elbow, wrist = (person.positions_m[skeleton.index(joint)] for joint in ARM)
    upper_m, lower_m = np.linalg.norm(elbow - shoulder), np.linalg.norm(wrist - elbow)
    later = away_m(unseen, skeleton, lost, 2.0)
    assert later["left_elbow"] == pytest.approx(2 * upper_m)
    assert later["left_wrist"] == pytest.approx(np.linalg.norm(wrist - shoulder) + upper_m + lower_m)
    # The trunk walks: the reach is from where the shoulder may be.
    gone = hidden(person, skeleton, *skeleton.joints)
    whole = away_m(unseen, skeleton, gone, 2.5)
    assert whole["left_shoulder"] == pytest.approx(0.5 * LIMITS.walking_m_s)  # seen at 2 s
    assert whole["left_elbow"] == pytest.approx(0.5 * LIMITS.walking_m_s + 2 * upper_m)
    assert away_m(unseen, skeleton, person, 3.1)["left_wrist"] == 0.0


def test_what_was_predicted_to_move_counts_too(skeleton: Skeleton) -> None:
    """It may have stayed where it was seen."""
    unseen, person = Unseen(skeleton, LIMITS), live_person(standing_m(skeleton))
    away_m(unseen, skeleton, person, 0.0)
    moved_m = person.positions_m.copy()
    moved_m[skeleton.index("left_wrist")] += (0.1, 0.0, 0.0)
    lost = hidden(replace(person, positions_m=moved_m), skeleton, "left_wrist")
    assert away_m(unseen, skeleton, lost, 0.05)["left_wrist"] == pytest.approx(0.1 + 0.05 * LIMITS.hand_m_s)


def test_of_an_arm_that_was_never_seen_only_the_reach_is_known(skeleton: Skeleton) -> None:
    person = hidden(live_person(standing_m(skeleton)), skeleton, "left_elbow", "left_wrist")
    shoulder, elbow = (person.positions_m[skeleton.index(joint)] for joint in ARM[:2])
    first = away_m(Unseen(skeleton, LIMITS), skeleton, person, 0.0)
    assert first["left_elbow"] == pytest.approx(2 * np.linalg.norm(elbow - shoulder))


def test_somebody_keeps_what_is_known_with_another_number(skeleton: Skeleton) -> None:
    unseen, person = Unseen(skeleton, LIMITS), live_person(standing_m(skeleton), 1)
    away_m(unseen, skeleton, person, 0.0)
    lost = hidden(person, skeleton, "left_wrist")
    renamed = replace(lost, person=7, former=1)
    assert away_m(unseen, skeleton, renamed, 0.1)["left_wrist"] == pytest.approx(0.1 * LIMITS.hand_m_s)
