"""Those who were followed and are not any more: they may come back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.association.identity import Likeness, log_ratio_of_place
from fgpose.association.track import Track

# Log odds at which somebody is recognised, and by which the next likely must be less so.
_RECOGNISED, _UNAMBIGUOUS = np.log(10.0), np.log(5.0)
# Who was seen for so long beside a newcomer is not the newcomer. Shorter, some cameras may have gone on with the old
# track while others agreed on a better one.
_OVERLAP_S, _IMPOSSIBLE = 0.3, -1e3


@dataclass(frozen=True, eq=False)
class _Somebody:
    likeness: Likeness
    middle_m: Float[np.ndarray, 3]
    time_s: float


class _Room:
    """Where people have been."""

    def __init__(self) -> None:
        self._low_m, self._high_m = np.full(3, np.inf), np.full(3, -np.inf)

    def add(self, place_m: Float[np.ndarray, 3]) -> None:
        self._low_m, self._high_m = np.minimum(self._low_m, place_m), np.maximum(self._high_m, place_m)

    @property
    def area_m2(self) -> float:
        """Of the floor, whichever axis is vertical: the two longer sides."""
        extent_m = np.sort(np.maximum(self._high_m - self._low_m, 0.0))
        return float(extent_m[1] * extent_m[2])


class Lost:
    """Everybody who was lost in the last forget_s seconds."""

    def __init__(self, forget_s: float) -> None:
        self._forget_s = forget_s
        self._people: dict[int, _Somebody] = {}
        self.room = _Room()

    def __len__(self) -> int:
        return len(self._people)

    def add(self, track: Track) -> None:
        """Somebody who is not followed any more."""
        self._people[track.person] = _Somebody(track.likeness, track.middle_m, track.seen_s)

    def recognised(self, new: Sequence[Track], now_s: float) -> list[tuple[Track, int, str]]:
        """Who of these new tracks is somebody who was lost, by number, and why; nobody is two of them.

        The likeness of the track then includes what was known before.
        """
        from scipy.optimize import linear_sum_assignment

        self._people = {n: each for n, each in self._people.items() if each.time_s >= now_s - self._forget_s}
        if not new or not self._people:
            return []
        people, found = list(self._people.items()), []
        score = np.array([[self._log_ratio(track, somebody) for _, somebody in people] for track in new])
        for n, m in zip(*linear_sum_assignment(score, maximize=True), strict=True):
            others = np.delete(score[n], m)
            if score[n, m] < _RECOGNISED or (len(others) and score[n, m] - others.max() < _UNAMBIGUOUS):
                continue
            track, (person, somebody) = new[n], people[m]
            away_s = track.founded_s - somebody.time_s
            found.append((track, person, f"away for {away_s:.1f} s, log odds of place and bones {score[n, m]:.1f}"))
            track.likeness.join(somebody.likeness)
            del self._people[person]
        return found

    def _log_ratio(self, track: Track, somebody: _Somebody) -> float:
        """Of the probabilities that a track is of somebody who was lost, and that it is of anybody."""
        gap_s = track.founded_s - somebody.time_s
        if gap_s < -_OVERLAP_S:
            return _IMPOSSIBLE
        place = log_ratio_of_place(somebody.middle_m, track.founded_m, max(gap_s, 0.0), self.room.area_m2)
        return place + track.likeness.log_ratio(somebody.likeness)
