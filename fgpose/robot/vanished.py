"""Who was lost where two cameras observe, and was not seen again: they may still be there, hidden by the robot.

Nobody leaves from there unseen. Who goes is lost where fewer than two cameras observe; who comes out from behind the
robot, or is found anew, is somebody new near where they were lost.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.geometry.camera import CameraRig
from fgpose.geometry.field_of_view import in_views
from fgpose.live.frame import LiveFrame, LivePerson
from fgpose.live.tracking.observed import Volume
from fgpose.robot.body import RADIUS_M
from fgpose.robot.cell import Limits
from fgpose.robot.reach import Places
from fgpose_factors.robust_statistics import known_medians

# Who is founded anew may be turned round, and their middle elsewhere in the body.
_FOUND_AGAIN_M = 0.5


@dataclass(frozen=True, eq=False)
class Vanished:
    """Somebody as the last frame said it that knew them."""

    person: int
    time_s: float
    """Of that frame."""
    middle_m: Float[np.ndarray, " 3"]
    places: Places
    """Of this one person."""
    tracking_since_s: float
    """Of a tracker that has begun anew since, numbers mean nobody."""


class Remembered:
    """Everybody who vanished in the last lost_s seconds and was not seen again.

    Args:
        rig, volume: where nobody can leave unseen: where two cameras observe, of the volume if there is one.
        limits: how long, how far people are found again from where they were lost, and how fast they walk.
    """

    def __init__(self, rig: CameraRig, volume: Volume | None, limits: Limits) -> None:
        self._rig, self._volume, self._limits = rig, volume, limits
        self.people: tuple[Vanished, ...] = ()

    def add(self, frame: LiveFrame, before: LiveFrame, places: Places) -> None:
        """The next frame.

        Args:
            frame: it.
            before: the one before it.
            places: of the people of that one.
        """
        known, present = _numbers(before), _numbers(frame)
        missing = [*self.people]
        for number, person in enumerate(before.people):
            if person.person not in present and self._is_hidden(person, frame):
                since_s, its = before.tracking_since_s, places.of_person(number)
                missing.append(Vanished(person.person, before.time_s, _middle_m(person), its, since_s))
        missing = [each for each in missing if not self._is_over(each, frame)]
        for person in frame.people:
            if not {person.person, person.former} & known:
                found = [each for each in missing if self._may_be(person, each, frame.time_s)]
                if found:
                    missing.remove(min(found, key=lambda each: _apart_m(_middle_m(person), each.middle_m)))
        self.people = tuple(missing)

    def _is_hidden(self, person: LivePerson, frame: LiveFrame) -> bool:
        """Whether somebody was lost where they cannot have left, and is not somebody else who was found twice."""
        middle_m = _middle_m(person)
        if not np.isfinite(middle_m).all():
            return True
        twice_m = min((_apart_m(_middle_m(other), middle_m) for other in frame.people), default=np.inf)
        is_inside = self._volume is None or self._volume.contains(middle_m).all()
        # Two bodies are at least a trunk apart.
        return bool(is_inside and in_views(self._rig, middle_m[None]).sum() >= 2 and twice_m >= 2 * RADIUS_M["trunk"])

    def _is_over(self, missing: Vanished, frame: LiveFrame) -> bool:
        """Whether they are recognised, or too long ago."""
        is_same_tracker = frame.tracking_since_s == missing.tracking_since_s
        is_recognised = is_same_tracker and missing.person in _numbers(frame)
        return is_recognised or frame.time_s - missing.time_s > self._limits.lost_s

    def _may_be(self, person: LivePerson, missing: Vanished, now_s: float) -> bool:
        """Whether who is found now may be who is missing. Somebody else comes in elsewhere."""
        walked_m = _FOUND_AGAIN_M + self._limits.walking_m_s * (now_s - missing.time_s)
        apart_m = _apart_m(_middle_m(person), missing.middle_m)
        return bool(apart_m < min(walked_m, self._limits.missing_within_m))


def _numbers(frame: LiveFrame) -> set[int | None]:
    return {person.person for person in frame.people} | {person.former for person in frame.people} - {None}


def _middle_m(person: LivePerson) -> Float[np.ndarray, " 3"]:
    return known_medians(person.positions_m, axis=0)


def _apart_m(one_m: Float[np.ndarray, " 3"], other_m: Float[np.ndarray, " 3"]) -> float:
    """inf where one is not known."""
    return float(np.nan_to_num(np.linalg.norm(one_m - other_m), nan=np.inf))
