"""How far joints may be from where they are predicted to be, while fewer than two cameras see them.

What a tracker predicts of them is what people usually do. Who reaches for something while a robot hides the arm does
what a robot must not take for unusual: the covariance of the tracker, taken as normal, was exceeded by 30 cm.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from fgpose.live.frame import LiveFrame, LivePerson
from fgpose.robot.cell import Limits
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Status

_ARM, _LEG = ("shoulder", "elbow", "wrist"), ("hip", "knee", "ankle")


@dataclass(frozen=True, eq=False)
class _Seen:
    """When and where each joint of somebody was observed last."""

    time_s: Float[np.ndarray, " joint"]
    """-inf: never."""
    positions_m: Float[np.ndarray, "joint 3"]


class Unseen:
    """Bounds of the errors of joints that are predicted: a joint can have moved with the speeds of ISO 13855 since it
    was observed, but a limb is no longer than it is.

    Args:
        skeleton: with shoulders, elbows, wrists, hips, knees and ankles.
        limits: how fast people walk and reach.
    """

    def __init__(self, skeleton: Skeleton, limits: Limits) -> None:
        sides = ("left", "right")
        self._limbs = [[skeleton.index(f"{side}_{joint}") for joint in limb] for side in sides for limb in (_ARM, _LEG)]
        self._of_limbs = [joint for _, *joints in self._limbs for joint in joints]
        self._speed_m_s = np.full(skeleton.n_joints, limits.walking_m_s)
        self._speed_m_s[[skeleton.index(f"{side}_{joint}") for side in sides for joint in _ARM[1:]]] = limits.hand_m_s
        self._seen: dict[int, _Seen] = {}

    def away_m(self, frame: LiveFrame) -> Float[np.ndarray, "person joint"]:
        """Of the people of the next frame: how far each joint may be from where it is said to be; 0 where it is
        observed, inf where it has no place or nothing tells."""
        self._seen = {person.person: self._last_seen(person, frame.time_s) for person in frame.people}
        away_m = [self._away_m(person, frame.time_s) for person in frame.people]
        return np.array(away_m).reshape(-1, len(self._speed_m_s))

    def _last_seen(self, person: LivePerson, time_s: float) -> _Seen:
        before = self._seen.get(person.person)
        if before is None and person.former is not None:
            before = self._seen.get(person.former)
        if before is None:
            # Who is new has been seen just now; of an arm or leg that was not, nothing is known.
            never_s = np.where(_has_place(person), time_s, -math.inf)
            never_s[self._of_limbs] = -math.inf
            before = _Seen(never_s, person.positions_m)
        is_seen = (person.status == Status.OBSERVED) & _has_place(person)
        return _Seen(
            np.where(is_seen, time_s, before.time_s),
            np.where(is_seen[:, None], person.positions_m, before.positions_m),
        )

    def _away_m(self, person: LivePerson, time_s: float) -> Float[np.ndarray, " joint"]:
        seen, positions_m = self._seen[person.person], person.positions_m
        # From where it was seen; it is predicted to have moved since.
        predicted_m = np.nan_to_num(np.linalg.norm(positions_m - seen.positions_m, axis=-1))
        away_m = predicted_m + self._speed_m_s * (time_s - seen.time_s)

        def apart_m(one: int, other: int) -> float:
            return float(np.nan_to_num(np.linalg.norm(positions_m[one] - positions_m[other]), nan=math.inf))

        for root, middle, end in self._limbs:
            upper_m, lower_m = apart_m(root, middle), apart_m(middle, end)
            away_m[middle] = min(away_m[middle], away_m[root] + 2 * upper_m)
            of_both_m = away_m[root] + apart_m(root, end) + upper_m + lower_m
            away_m[end] = min(away_m[end], away_m[middle] + 2 * lower_m, of_both_m)
        return np.where(_has_place(person), away_m, math.inf)


def _has_place(person: LivePerson) -> Bool[np.ndarray, " joint"]:
    return np.asarray(np.isfinite(person.positions_m).all(axis=-1))
