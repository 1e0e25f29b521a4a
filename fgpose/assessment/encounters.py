"""People who come near one another, and whose identities are exchanged or lost there."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from jaxtyping import Float

from fgpose.assessment.crowd import NOBODY, Crowd
from fgpose.assessment.metrics import mean_known
from fgpose.assessment.stays import MIN_AWAY_S, NAMED_WITHIN_S, Matched, owners, stretches_of

NEAR_M = 1.0
# A wrong identity shows when the two have parted.
_AFTER_S = 0.5


@dataclass(frozen=True)
class Encounter:
    """Two true people nearer to each other than NEAR_M, from beginning to end."""

    people: tuple[int, int]
    """True identities, ascending."""
    begin_s: float
    end_s: float
    distance_m: float
    """At the nearest, of the middles of the joints that both have."""
    n_switches: int
    """Of the identities of both, meanwhile or within 0.5 s after it. A switch during several encounters is that of the
    nearest. One after an absence is none, nor is that by which somebody is recognised who has come back: see Stay."""


@dataclass(frozen=True)
class _Switch:
    person: int
    """Index of the true identity."""
    last_s: float
    """Last match to the identity before."""
    first_s: float
    """First to the new one."""


def encounters(
    followed: tuple[Matched, ...],
    truth: Crowd,
    estimate: Crowd,
    time_s: Float[np.ndarray, " frame"],
    near_m: float = NEAR_M,
) -> tuple[Encounter, ...]:
    """Everybody's encounters, in the order of their beginning.

    Args:
        followed: see stays.matched.
        time_s: of all frames, increasing.
        near_m: nearer than this is an encounter.
    """
    found = sorted(_apart(truth, time_s, near_m), key=lambda each: (each.begin_s, each.people))
    n_switches = [0] * len(found)
    for switch in _switches(followed, time_s, len(estimate.identities)):
        name = truth.identities[switch.person]
        own = [
            (each.distance_m, n)
            for n, each in enumerate(found)
            if name in each.people and each.begin_s <= switch.first_s and switch.last_s <= each.end_s + _AFTER_S
        ]
        if own:
            n_switches[min(own)[1]] += 1
    return tuple(replace(each, n_switches=n) for each, n in zip(found, n_switches, strict=True))


def _apart(truth: Crowd, time_s: Float[np.ndarray, " frame"], near_m: float) -> list[Encounter]:
    """Without their switches."""
    pairs, apart_m = np.zeros((0, 3), dtype=int), np.zeros(0)
    for a, b in combinations(range(truth.person.shape[1]), 2):
        distance_m = np.linalg.norm(mean_known(truth.positions_m[:, a] - truth.positions_m[:, b], axis=1), axis=-1)
        frames = np.flatnonzero(distance_m < near_m)
        of_slots = np.column_stack([truth.person[frames, a], truth.person[frames, b], frames])
        pairs, apart_m = np.concatenate([pairs, of_slots]), np.concatenate([apart_m, distance_m[frames]])
    order = np.lexsort(pairs.T[::-1])
    pairs, apart_m = pairs[order], apart_m[order]
    ends = (np.diff(pairs[:, :2], axis=0) != 0).any(axis=1) | (np.diff(pairs[:, 2]) > 1)
    found = []
    for part in np.split(np.arange(len(pairs)), np.flatnonzero(ends) + 1) if len(pairs) else ():
        first, second = (truth.identities[index] for index in pairs[part[0], :2])
        begin_s, end_s = time_s[pairs[part[[0, -1]], 2]].tolist()
        found.append(Encounter((first, second), begin_s, end_s, float(apart_m[part].min()), 0))
    return found


def _switches(followed: tuple[Matched, ...], time_s: Float[np.ndarray, " frame"], n_identities: int) -> list[_Switch]:
    found = []
    for index, person in enumerate(followed):
        begins, _ = stretches_of(person, time_s, MIN_AWAY_S)
        known = person.identity != NOBODY
        frames, identity = person.frames[known], person.identity[known]
        stay = np.searchsorted(begins, frames, side="right") - 1
        changes = np.flatnonzero((np.diff(identity) != 0) & (np.diff(stay) == 0)) + 1
        for change in changes.tolist():
            first_s = time_s[frames[stay == stay[change]][0]]
            is_early = time_s[frames[change]] <= first_s + NAMED_WITHIN_S
            begin = int(begins[stay[change]])
            if is_early and owners(followed, begin, n_identities)[identity[change]] == index:
                continue
            found.append(_Switch(index, float(time_s[frames[change - 1]]), float(time_s[frames[change]])))
    return found
