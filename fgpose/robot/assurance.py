"""What may be said of a link without a fault: the rules, from facts that each say when they were last proven.

Whatever is not known is a fault: a time of NaN is no proof. Nothing here remembers, measures or decides anything else;
faults are latched where distances are measured (fgpose.robot.distances). The table of docs/live_distances.md is RULES.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from fgpose.live.clock import FUTURE_S
from fgpose.robot.cell import Limits

FOUND_S = 1.0
"""A tracker that begins has found everybody whom two cameras have in their images: see benchmarks/found_again.py."""


@dataclass(frozen=True)
class Facts:
    """What is known of a link at one moment. Times are Unix time; NaN: never proven."""

    taken_s: float
    """The earliest at which images may have been taken that the people come from, whatever the clocks may be."""
    tracking_since_s: float
    """Since when the tracker has run without beginning anew."""
    tracked_s: float
    """Until when it has: its newest image."""
    pose_s: float
    """Of the pose of the link; now for zones."""
    is_rigid: bool
    """Whether that is a rigid transform."""
    observed_share: float
    """Of the surroundings of the link, by two cameras that have been ok for FOUND_S: who came before is found then."""
    not_ok: tuple[str, ...] = ()
    """The other cameras, with what they are."""
    unproven: tuple[str, ...] = ()
    """Cameras of which nothing tells how old their images are."""
    doubt_s: float = 0.0
    """How much of the age there is only if no clock is behind."""
    incomplete: tuple[str, ...] = ()
    """People near the link, or anywhere, whose pose lacks what is needed for their distance."""
    lost: tuple[str, ...] = ()
    """People who were lost near the link, where they cannot have left unseen, and were not seen again."""
    nobodys: str = ""
    """What cameras that are ok have shown near the link for a while and is none of the people; empty: nothing."""


@dataclass(frozen=True)
class Rule:
    """Something that must be known."""

    needs: str
    """In words, for people."""
    holds: Callable[[Facts, Limits, float], bool]
    """At a moment, Unix time. False where anything is NaN."""
    reason: Callable[[Facts, Limits, float], str]
    """Of the fault if it does not hold."""


def faults_of(facts: Facts, limits: Limits, now_s: float) -> list[str]:
    """Why a distance may not be believed, in the order of RULES; none: it may be said without a fault."""
    return [rule.reason(facts, limits, now_s) for rule in RULES if not rule.holds(facts, limits, now_s)]


def _age(what: str, nothing: str, age_s: float) -> str:
    if math.isnan(age_s):
        return nothing
    return f"{what} {age_s:.2f} s old" if age_s >= 0 else f"{what} {-age_s:.2f} s ahead of the clock"


def is_new(time_s: float, limits: Limits, now_s: float) -> bool:
    """Whether what is of a time may still be used; not if that is NaN."""
    return -FUTURE_S <= now_s - time_s <= limits.max_age_s


RULES = (
    Rule(
        "images, none older than max_age_s by the worse of what its stamp and its arrival say, none ahead of the clock",
        lambda facts, limits, now_s: is_new(facts.taken_s, limits, now_s),
        lambda facts, limits, now_s: (
            _age("the data are", "no image has come yet", now_s - facts.taken_s)
            + (f", or a camera's clock is {facts.doubt_s:.2f} s behind" if facts.doubt_s > 0 else "")
        ),
    ),
    Rule(
        "of every camera in use, something that tells how old its images are",
        lambda facts, limits, now_s: not facts.unproven,
        lambda facts, limits, now_s: (
            f"nothing tells how old the images of {', '.join(facts.unproven)} are: say latency_s or clock (rig file)"
        ),
    ),
    Rule(
        f"a tracker that has run for {FOUND_S:g} s without beginning anew: before that nobody may mean not found yet",
        lambda facts, limits, now_s: facts.tracked_s - facts.tracking_since_s >= FOUND_S,
        lambda facts, limits, now_s: (
            f"the tracker began {facts.tracked_s - facts.tracking_since_s:.2f} s ago: people may not be found yet"
            if facts.tracking_since_s <= facts.tracked_s
            else "the tracker has not begun"
        ),
    ),
    Rule(
        f"two cameras that have been ok for {FOUND_S:g} s on min_observed_share of the surroundings of the link",
        lambda facts, limits, now_s: facts.observed_share >= limits.min_observed_share,
        lambda facts, limits, now_s: (
            f"two cameras observe only {facts.observed_share:.0%} of its surroundings"
            f"{' (' + ', '.join(facts.not_ok) + ')' if facts.not_ok else ''}"
        ),
    ),
    Rule(
        "a pose of the link, a rigid transform, not older than max_age_s, not ahead of the clock",
        lambda facts, limits, now_s: facts.is_rigid and is_new(facts.pose_s, limits, now_s),
        lambda facts, limits, now_s: (
            _age("its pose is", "it has no pose", now_s - facts.pose_s)
            if facts.is_rigid or math.isnan(facts.pose_s)
            else "its pose is not a rigid transform"
        ),
    ),
    Rule(
        "all joints of people nearer than missing_within_m, and a place of everybody",
        lambda facts, limits, now_s: not facts.incomplete,
        lambda facts, limits, now_s: "; ".join(facts.incomplete),
    ),
    Rule(
        "that who was lost in the surroundings of the link, where two cameras observe, was seen again; for lost_s",
        lambda facts, limits, now_s: not facts.lost,
        lambda facts, limits, now_s: "; ".join(facts.lost),
    ),
    Rule(
        "no detection of a camera that is ok that may be near the link and is nobody's, for nobodys_s",
        lambda facts, limits, now_s: not facts.nobodys,
        lambda facts, limits, now_s: facts.nobodys,
    ),
)
"""All of them."""
