"""Who comes back in a recording: the passages of the same person, linked over the times in which they were away.

As a flow of minimal cost through the passages (Zhang, Li and Nevatia, Global Data Association for Multi-Object Tracking
Using Network Flows, 2008). Without false passages, which the sequential test has ruled out, this is an assignment of
those who come to those who were lost.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fgpose.association.identity import RECOGNISED, UNAMBIGUOUS, Passage
from fgpose.association.lost import Lost
from fgpose.association.track import Track


@dataclass(frozen=True)
class Link:
    """Somebody who was lost, and who they are later."""

    before: int
    after: int
    log_odds: float


class EverybodyLost(Lost):
    """Keeps everybody who was ever lost, and recognises nobody yet."""

    def __init__(self) -> None:
        super().__init__(np.inf)
        self.tracks: list[Track] = []

    def add(self, track: Track) -> None:
        self.tracks.append(track)


def links(passages: Mapping[int, Passage], room_m2: float) -> list[Link]:
    """Passages of the same person, in the order of time of the later ones.

    A link is made where all others together would explain the recording worse without it, by the odds at which somebody
    is recognised online.

    Args:
        passages: by number.
        room_m2: area in which people have been.
    """
    numbers = list(passages)
    if len(numbers) < 2:
        return []
    of = list(passages.values())
    # A link is worth what it exceeds these odds by; that the next best must be worse by the other factor makes up for
    # the rest.
    least = RECOGNISED - UNAMBIGUOUS
    worth = np.array([[before.log_ratio(after, room_m2) - least for after in of] for before in of])
    total, chosen = _best(worth)
    found = []
    for n, m in chosen:
        without = worth.copy()
        without[n, m] = 0.0
        if total - _best(without)[0] >= UNAMBIGUOUS:
            found.append(Link(numbers[n], numbers[m], float(worth[n, m] + least)))
    return sorted(found, key=lambda link: passages[link.after].begin_s)


def _best(worth: np.ndarray) -> tuple[float, list[tuple[int, int]]]:
    """Worth of the best links, and these."""
    from scipy.optimize import linear_sum_assignment

    worth = np.maximum(worth, 0.0)
    rows, columns = linear_sum_assignment(worth, maximize=True)
    made = worth[rows, columns] > 0
    return float(worth[rows, columns].sum()), list(zip(rows[made].tolist(), columns[made].tolist(), strict=True))
