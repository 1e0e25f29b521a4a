"""Those who were followed and are not any more: who comes back, as people come or when all have come.

In a whole recording the passages of the same person are linked over the times in which they were away, as a flow of
minimal cost through the passages (Zhang, Li and Nevatia, Global Data Association for Multi-Object Tracking Using
Network Flows, 2008). Without false passages, which the sequential test has ruled out, this is an assignment of those
who come to those who were lost.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from fgpose.association.identity.likeness import RECOGNISED, UNAMBIGUOUS, Builds, Passage
from fgpose.association.track import Track

# A false track that lasts for less than this share of the time does not make the room larger.
_OUTLIERS = 0.01
_SAMPLED_S = 1.0
# Of strangers this share at most ever reaches odds of 1 / share, however often these are looked at (Ville's inequality;
# Wald 1945). At the odds at which somebody is recognised that is one of five.
_WRONG = 0.05
CERTAIN = -np.log(_WRONG)
"""Log odds from which on somebody who was recognised is not provisional any more."""


class _Room:
    """Where people have been of late."""

    def __init__(self, forget_s: float) -> None:
        self._forget_s = forget_s
        self._places: deque[tuple[float, Float[np.ndarray, " 3"]]] = deque()

    def add(self, places_m: Sequence[Float[np.ndarray, " 3"]], now_s: float) -> None:
        """Where everybody is; one moment in a second counts."""
        if not places_m or (self._places and now_s < self._places[-1][0] + _SAMPLED_S):
            return
        self._places.extend((now_s, place_m) for place_m in places_m)
        while self._places[0][0] < now_s - self._forget_s:
            self._places.popleft()

    @property
    def area_m2(self) -> float:
        """Of the floor, whichever axis is vertical: the two longer sides. Zero where nobody has been."""
        if not self._places:
            return 0.0
        low_m, high_m = np.quantile([place_m for _, place_m in self._places], (_OUTLIERS, 1 - _OUTLIERS), axis=0)
        extent_m = np.sort(high_m - low_m)
        return float(extent_m[1] * extent_m[2])


class Lost:
    """Everybody who was lost in the last forget_s seconds."""

    def __init__(self, forget_s: float) -> None:
        self._forget_s = forget_s
        self._people: dict[int, Passage] = {}
        self._claims: dict[Track, Passage] = {}
        """Of those who were recognised, and not for certain yet: who they are taken for."""
        self._doubted: set[Track] = set()
        self.room = _Room(forget_s)
        self.builds = Builds()

    def __len__(self) -> int:
        return len(self._people)

    def add(self, track: Track) -> None:
        """Somebody who is not followed any more."""
        if track in self._claims:
            track.likeness.join(self._claims.pop(track).likeness)
        self._people[track.person] = track.passage

    def learn(self, present: Sequence[Track], now_s: float) -> None:
        """Where people are, and how far their bones differ, from those who are there."""
        self.room.add([track.middle_m for track in present], now_s)
        if self.builds.is_due(now_s):
            self.builds.learn([track.passage for track in present], self._people.values(), now_s)

    @property
    def passages(self) -> dict[int, Passage]:
        """Of everybody who is remembered, by number."""
        return dict(self._people)

    def remember(self, passages: Mapping[int, Passage]) -> None:
        """People who were lost before this began."""
        self._people |= passages

    def is_claimed(self, track: Track) -> bool:
        """Whether somebody was recognised, and not for certain yet."""
        return track in self._claims

    def passage_of(self, track: Track) -> Passage:
        """Of somebody who is followed, with all that is known of who they are taken for."""
        passage = track.passage
        if track not in self._claims:
            return passage
        return replace(passage, likeness=Passage.joined([self._claims[track], passage]).likeness)

    def doubted(self, present: Sequence[Track]) -> list[tuple[Track, float]]:
        """Of whom bones, looks and place now speak against who they were recognised as, and the log odds; once of each.
        What was known of those before joins that of who is recognised for certain."""
        self._claims = {track: before for track, before in self._claims.items() if track in present}
        self._doubted &= self._claims.keys()
        doubted, area_m2 = [], self.room.area_m2
        for track, before in list(self._claims.items()):
            log_odds = before.log_ratio(track.passage, area_m2, self.builds)
            if log_odds >= CERTAIN:
                track.likeness.join(self._claims.pop(track).likeness)
            elif log_odds <= -UNAMBIGUOUS and track not in self._doubted:
                self._doubted.add(track)
                doubted.append((track, log_odds))
        return doubted

    def recognised(self, new: Sequence[Track], now_s: float) -> list[tuple[Track, int, str]]:
        """Who of these new tracks is somebody who was lost, by number, and why; nobody is two of them.

        They may be somebody else until that is certain, see doubted.
        """
        from scipy.optimize import linear_sum_assignment

        self._people = {n: each for n, each in self._people.items() if each.end_s >= now_s - self._forget_s}
        if not new or not self._people:
            return []
        people, found = list(self._people.items()), []
        area_m2 = self.room.area_m2
        ratio = np.array(
            [[before.log_ratio(track.passage, area_m2, self.builds) for _, before in people] for track in new]
        )
        # Against that they are any other who was lost, or somebody new, each as probable as the other beforehand.
        anew = np.zeros(len(new))
        score = np.stack(
            [own - np.logaddexp.reduce([anew, *np.delete(ratio.T, m, axis=0)]) for m, own in enumerate(ratio.T)], axis=1
        )
        for n, m in zip(*linear_sum_assignment(score, maximize=True), strict=True):
            if score[n, m] < UNAMBIGUOUS:
                continue
            track, (person, somebody) = new[n], people[m]
            away_s = track.founded_s - somebody.end_s
            found.append(
                (track, person, f"away for {away_s:.1f} s, log odds of place, bones and looks {score[n, m]:.1f}")
            )
            self._claims[track] = somebody
            del self._people[person]
        return found


class EverybodyLost(Lost):
    """Keeps everybody who was ever lost, and recognises nobody yet."""

    def __init__(self) -> None:
        super().__init__(np.inf)
        self.tracks: list[Track] = []

    def add(self, track: Track) -> None:
        self.tracks.append(track)


@dataclass(frozen=True)
class Reidentification:
    """Somebody who was lost, and who they are later."""

    before: int
    after: int
    log_odds: float


def links(passages: Mapping[int, Passage], room_m2: float, builds: Builds | None = None) -> list[Reidentification]:
    """Passages of the same person, in the order of time of the later ones.

    A link is made where all others together would explain the recording worse without it, by the odds at which somebody
    is recognised online.

    Args:
        passages: by number.
        room_m2: area in which people have been.
        builds: how far the lengths of people differ.
    """
    numbers = list(passages)
    if len(numbers) < 2:
        return []
    of = list(passages.values())
    # A link is worth what it exceeds these odds by; that the next best must be worse by the other factor makes up for
    # the rest.
    least = RECOGNISED - UNAMBIGUOUS
    worth = np.array([[before.log_ratio(after, room_m2, builds) - least for after in of] for before in of])
    total, chosen = _best(worth)
    found = []
    for n, m in chosen:
        without = worth.copy()
        without[n, m] = 0.0
        if total - _best(without)[0] >= UNAMBIGUOUS:
            found.append(Reidentification(numbers[n], numbers[m], float(worth[n, m] + least)))
    return sorted(found, key=lambda link: passages[link.after].begin_s)


def _best(worth: np.ndarray) -> tuple[float, list[tuple[int, int]]]:
    """Worth of the best links, and these."""
    from scipy.optimize import linear_sum_assignment

    worth = np.maximum(worth, 0.0)
    rows, columns = linear_sum_assignment(worth, maximize=True)
    made = worth[rows, columns] > 0
    return float(worth[rows, columns].sum()), list(zip(rows[made].tolist(), columns[made].tolist(), strict=True))
