"""How people are received who come into the room: when they are found, and as whom."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.assessment.crowd import NOBODY, Crowd

# Shorter gaps in the truth are frames that its cameras missed, not absence.
MIN_AWAY_S = 1.0
# Two or three samples of the bones, whose errors are correlated for a third of a second. Who is there for less, mostly
# because the recording ends, need not be recognised.
MIN_STAY_S = 1.0
# Nobody is recognised at sight: bones have to be measured. A name that lasts longer has been believed.
NAMED_WITHIN_S = 3.0


@dataclass(frozen=True)
class Stay:
    """A true person in the room, from coming to going."""

    person: int
    """True identity."""
    begin_s: float
    end_s: float
    """Last frame in which the person is there."""
    away_s: float
    """Time since the person's last stay; inf: the first one."""
    first_match_s: float
    """When the person is found; inf: never during the stay."""
    is_recognised: bool
    """Whether the person is called by an identity of their own from before, in the last match within NAMED_WITHIN_S of
    the first one. An identity is that of the person with whom it was matched in most frames before the stay."""
    is_mistaken: bool
    """Whether any match in this time is to an identity of somebody else, who is or was there."""

    @property
    def duration_s(self) -> float:
        return self.end_s - self.begin_s


@dataclass(frozen=True, eq=False)
class Matched:
    """How one true person was followed: the frames in which the person is there, and as whom."""

    frames: Int[np.ndarray, " there"]
    identity: Int[np.ndarray, " there"]
    """Index of the estimated identity that is matched, NOBODY: none."""


def matched(partner: Int[np.ndarray, "frame truth"], truth: Crowd, estimate: Crowd) -> tuple[Matched, ...]:
    """Of every true identity, given the matches of clear_mot.match_frames."""
    found = np.full(partner.shape, NOBODY)
    frames, slots = np.nonzero(partner != NOBODY)
    found[frames, slots] = estimate.person[frames, partner[frames, slots]]
    every = (np.nonzero(truth.person == index) for index in range(len(truth.identities)))
    return tuple(Matched(frames, found[frames, slots]) for frames, slots in every)


def stays(
    followed: tuple[Matched, ...],
    truth: Crowd,
    estimate: Crowd,
    time_s: Float[np.ndarray, " frame"],
    min_away_s: float = MIN_AWAY_S,
) -> tuple[Stay, ...]:
    """Everybody's stays, in the order of the true identities, then of time.

    Args:
        time_s: of all frames, increasing.
        min_away_s: a person who is not there for less has not been away.
    """
    found: list[Stay] = []
    for index, person in enumerate(followed):
        begins, ends = stretches_of(person, time_s, min_away_s)
        for n, (begin, end) in enumerate(zip(begins.tolist(), ends.tolist(), strict=True)):
            away_s = time_s[begin] - time_s[ends[n - 1]] if n else np.inf
            owner = owners(followed, begin, len(estimate.identities))
            inside = (person.frames >= begin) & (person.frames <= end) & (person.identity != NOBODY)
            match_s, of = time_s[person.frames[inside]], owner[person.identity[inside]]
            first_s = float(match_s.min(initial=np.inf))
            of = of[match_s <= first_s + NAMED_WITHIN_S]
            found.append(
                Stay(
                    person=truth.identities[index],
                    begin_s=float(time_s[begin]),
                    end_s=float(time_s[end]),
                    away_s=float(away_s),
                    first_match_s=first_s,
                    is_recognised=bool((of[-1:] == index).any()),
                    is_mistaken=bool(((of != NOBODY) & (of != index)).any()),
                )
            )
    return tuple(found)


def stretches_of(
    person: Matched, time_s: Float[np.ndarray, " frame"], min_away_s: float
) -> tuple[Int[np.ndarray, " stay"], Int[np.ndarray, " stay"]]:
    """First and last frame of each of a person's stays."""
    away = np.flatnonzero(np.diff(time_s[person.frames]) >= min_away_s)
    edges = np.concatenate([[0], away + 1, [len(person.frames)]]) if len(person.frames) else np.zeros(1, dtype=int)
    return person.frames[edges[:-1]], person.frames[edges[1:] - 1]


def owners(followed: tuple[Matched, ...], before: int, n_identities: int) -> Int[np.ndarray, " identity"]:
    """Index of the true person with whom each estimated identity is matched most before a frame, NOBODY: never."""
    counts = np.zeros((len(followed), n_identities), dtype=int)
    for index, person in enumerate(followed):
        known = (person.frames < before) & (person.identity != NOBODY)
        counts[index] = np.bincount(person.identity[known], minlength=n_identities)
    return np.where(counts.any(axis=0), counts.argmax(axis=0), NOBODY)


def confirmation_delays_s(
    stays: tuple[Stay, ...], seen: Mapping[int, Bool[np.ndarray, " frame"]], time_s: Float[np.ndarray, " frame"]
) -> tuple[float, ...]:
    """From when each stay's person is seen well enough to when the person is found: 0 where found before, inf where
    never. Stays during which the person is never seen well enough are left out.

    Args:
        seen: by true identity, whether enough cameras detect the person in each frame, as two.
    """
    delays_s = []
    for stay in stays:
        inside = seen[stay.person] & (time_s >= stay.begin_s) & (time_s <= stay.end_s)
        if inside.any():
            delays_s.append(max(stay.first_match_s - float(time_s[inside][0]), 0.0))
    return tuple(delays_s)


def false_tracks_s(
    partner: Int[np.ndarray, "frame truth"], estimate: Crowd, time_s: Float[np.ndarray, " frame"]
) -> tuple[float, ...]:
    """How long each false track lives: an estimated identity that is matched in less than half of its frames, made up
    or a double. Its frames, also where it has gaps, times the usual time between frames."""
    if len(time_s) < 2:
        return ()
    frames, slots = np.nonzero(partner != NOBODY)
    identity = estimate.person[frames, partner[frames, slots]]
    n_matched = np.bincount(identity, minlength=len(estimate.identities))
    n_there = estimate.n_frames_there
    return tuple((n_there[2 * n_matched < n_there] * float(np.median(np.diff(time_s)))).tolist())
