"""Those who were followed and are not any more: they may come back."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from fgpose.association.identity import RECOGNISED, UNAMBIGUOUS, Passage
from fgpose.association.track import Track


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
        self._people: dict[int, Passage] = {}
        self.room = _Room()

    def __len__(self) -> int:
        return len(self._people)

    def add(self, track: Track) -> None:
        """Somebody who is not followed any more."""
        self._people[track.person] = track.passage

    def recognised(self, new: Sequence[Track], now_s: float) -> list[tuple[Track, int, str]]:
        """Who of these new tracks is somebody who was lost, by number, and why; nobody is two of them.

        The likeness of the track then includes what was known before.
        """
        from scipy.optimize import linear_sum_assignment

        self._people = {n: each for n, each in self._people.items() if each.end_s >= now_s - self._forget_s}
        if not new or not self._people:
            return []
        people, found = list(self._people.items()), []
        area_m2 = self.room.area_m2
        score = np.array([[before.log_ratio(track.passage, area_m2) for _, before in people] for track in new])
        for n, m in zip(*linear_sum_assignment(score, maximize=True), strict=True):
            others = np.delete(score[n], m)
            if score[n, m] < RECOGNISED or (len(others) and score[n, m] - others.max() < UNAMBIGUOUS):
                continue
            track, (person, somebody) = new[n], people[m]
            away_s = track.founded_s - somebody.end_s
            found.append((track, person, f"away for {away_s:.1f} s, log odds of place and bones {score[n, m]:.1f}"))
            track.likeness.join(somebody.likeness)
            del self._people[person]
        return found
