"""What may be said without a fault: whatever is missing, old, ahead or NaN is one."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import pytest

from fgpose.live.clock import FUTURE_S
from fgpose.robot.assurance import FOUND_S, RULES, Facts, faults_of
from fgpose.robot.cell import Limits

NOW_S = 1000.0
LIMITS = Limits(max_age_s=0.5, min_observed_share=0.9)
KNOWN = Facts(NOW_S - 0.05, NOW_S - 60.0, NOW_S - 0.05, NOW_S - 0.01, True, 1.0)
PAGE = Path(__file__).parents[3] / "docs" / "live_distances.md"


def test_what_is_known_may_be_said() -> None:
    assert faults_of(KNOWN, LIMITS, NOW_S) == []


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"taken_s": NOW_S - 0.51}, "the data are 0.51 s old"),
        ({"taken_s": NOW_S + FUTURE_S + 0.01}, "the data are 0.11 s ahead of the clock"),
        ({"taken_s": math.nan}, "no image has come yet"),
        ({"taken_s": NOW_S - 0.7, "doubt_s": 0.6}, "the data are 0.70 s old, or a camera's clock is 0.60 s behind"),
        (
            {"unproven": ("cam_1", "cam_3")},
            "nothing tells how old the images of cam_1, cam_3 are: say latency_s or clock",
        ),
        ({"tracking_since_s": NOW_S - 0.35}, "the tracker began 0.30 s ago: people may not be found yet"),
        ({"tracking_since_s": math.nan}, "the tracker has not begun"),
        ({"tracked_s": math.nan}, "the tracker has not begun"),
        ({"observed_share": 0.5, "not_ok": ("cam_2 lost",)}, "two cameras observe only 50% of its surroundings (cam_2"),
        ({"observed_share": math.nan}, "two cameras observe only nan% of its surroundings"),
        ({"pose_s": NOW_S - 0.51}, "its pose is 0.51 s old"),
        ({"pose_s": NOW_S + 1.0}, "its pose is 1.00 s ahead of the clock"),
        ({"pose_s": math.nan, "is_rigid": False}, "it has no pose"),
        ({"is_rigid": False}, "its pose is not a rigid transform"),
        ({"lost": ("person 3 was lost 0.2 m from it",)}, "person 3 was lost 0.2 m from it"),
        ({"nobodys": "cam_1: somebody near it for 0.5 s"}, "cam_1: somebody near it for 0.5 s"),
        ({"incomplete": ("person 3 has no estimate of left_wrist",)}, "person 3 has no estimate of left_wrist"),
    ],
)
def test_whatever_is_missing_is_a_fault(change: dict[str, Any], reason: str) -> None:
    (said,) = faults_of(replace(KNOWN, **change), LIMITS, NOW_S)
    assert said.startswith(reason)


def test_every_fact_that_is_not_a_number_is_a_fault() -> None:
    numbers = [each.name for each in fields(Facts) if each.type == "float"]
    assert len(numbers) == 6
    numbers.remove("doubt_s")  # of words only
    for name in numbers:
        unknown: dict[str, Any] = {name: math.nan}
        assert faults_of(replace(KNOWN, **unknown), LIMITS, NOW_S), name
    assert faults_of(KNOWN, LIMITS, math.nan)


def test_a_fact_proves_nothing_for_longer_than_its_time() -> None:
    """Nothing happens any more: there is a fault as soon as the first proof is too old, and for ever."""
    until_s = KNOWN.taken_s + LIMITS.max_age_s
    assert faults_of(KNOWN, LIMITS, until_s - 0.001) == []
    for later_s in (0.001, 1.0, 1e6, 1e300, math.inf):
        assert faults_of(KNOWN, LIMITS, until_s + later_s)


def test_a_tracker_has_found_people_after_a_second() -> None:
    begun = replace(KNOWN, tracking_since_s=KNOWN.tracked_s - FOUND_S - 1e-6)
    assert faults_of(begun, LIMITS, NOW_S) == []


def test_the_rules_are_documented() -> None:
    text = " ".join(PAGE.read_text(encoding="utf-8").split())
    for rule in RULES:
        assert rule.needs in text
