"""Whether two people who were very near each other may have been exchanged, and who is who by what is seen of them
afterwards.

Detectors that mix up the limbs of two people do so for a while. Over so long, tracks that are as near as a body moves
in that time may go over from one body to the other, joint by joint, so that each image fits them well. How well they
were told apart is therefore judged by where each was expected that long before: the odds that each is still on its own
body, against those that they are exchanged, add up over the encounter as in a binary symmetric channel (Cover and
Thomas, Elements of Information Theory, section 7.1.4). Later bones and looks tell.
"""

from __future__ import annotations

import copy
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import combinations

import numpy as np

from fgpose.association.identity.appearance import MeanAppearance
from fgpose.association.identity.likeness import RECOGNISED, UNAMBIGUOUS, Builds, Likeness
from fgpose.association.likelihood import INDEPENDENT_JOINTS
from fgpose.association.pose_filter import PoseFilters
from fgpose.association.track import SAME_MOMENT_S, Track

# A detector that mixes two people up does so for about so long.
_MIXED_S = 0.3
# Farther apart, two are told apart within that time whatever the errors: a body moves by 0.2 m (standard deviation).
_NEAR_M = 1.0
# With these odds at every moment they are together: an hour of it would exchange them once.
_TOGETHER = np.log(3600.0 / _MIXED_S)
# One moment alone never makes it wholly open who is who: nor does it tell that they were exchanged.
_LEAST_ODDS = 0.1
_CERTAIN = 1 - 1e-9  # keeps odds finite
# They have parted when they were told apart for so long.
_PARTED_S = 0.5
# Lengths of bones err for as long as a pose lasts: who is who must be told for so long.
_POSE_S = 1.0


class Settled(Enum):
    """What is said of two people who were together."""

    PERHAPS = "perhaps exchanged"
    """It is open who is who."""
    EXCHANGED = "exchanged"
    """Bones and looks tell that each is the other."""
    KEPT = "not exchanged"
    """They tell that each is who they were."""


@dataclass(eq=False)
class Together:
    """Two people who are so near each other that they might be taken for each other, or were."""

    tracks: tuple[Track, Track]
    since_s: float
    until_s: float
    before: tuple[Likeness, Likeness]
    """What was known of each when it began."""
    correlation: float = 1.0
    """Of who they are with who they were: 1 - 2 p, where p is the probability that they are exchanged."""
    unclear_s: float = -np.inf
    """When they could least be told apart."""
    least_odds: float = np.inf
    has_parted: bool = False
    told: tuple[bool, float] | None = None
    """Whether bones and looks tell that they are exchanged, and since when; None: they do not tell."""

    @property
    def log_odds(self) -> float:
        """Of being exchanged, by motion alone; at most 0."""
        return -2 * float(np.arctanh(min(self.correlation, _CERTAIN)))

    @property
    def is_open(self) -> bool:
        """Whether they may be exchanged: each is not so certainly the same as somebody who is recognised."""
        return bool(self.log_odds > -UNAMBIGUOUS)

    def tell(self, log_odds: float, now_s: float, step_s: float) -> None:
        """That each is who they were, at a moment so much later than the last."""
        self.until_s = now_s
        if log_odds < self.least_odds:
            self.least_odds, self.unclear_s = log_odds, now_s
        self.correlation *= float(np.tanh(max(log_odds, _LEAST_ODDS) / 2)) ** min(step_s / _MIXED_S, 1.0)

    def meet_again(self) -> None:
        """Before it is known who is who: what bones told since is forgotten, for it may be of both."""
        self.has_parted, self.told = False, None

    def log_odds_after(self, builds: Builds) -> float:
        """Of being exchanged, by what is known of each before and afterwards too."""
        (one, other), (a, b) = self.before, (track.likeness for track in self.tracks)
        exchanged = b.log_ratio(one, builds) + a.log_ratio(other, builds)
        return self.log_odds + exchanged - a.log_ratio(one, builds) - b.log_ratio(other, builds)


@dataclass(frozen=True, eq=False)
class Finding:
    """What has become of two people who were together."""

    settled: Settled
    together: Together
    log_odds: float
    """Of being exchanged."""

    @property
    def reason(self) -> str:
        """Why, in words."""
        begin_s, end_s = self.together.since_s, self.together.until_s
        by = "motion" if self.settled is Settled.PERHAPS else "motion, bones and looks"
        return f"too near to be told apart from {begin_s:.1f} to {end_s:.1f} s, log odds of {by} {self.log_odds:.1f}"


class Encounters:
    """All pairs of those who are followed, and who of them were together."""

    def __init__(self, builds: Builds) -> None:
        self._builds = builds
        self._poses: deque[tuple[float, dict[Track, PoseFilters]]] = deque()
        """Of everybody, at the moments of the last _MIXED_S and the one before."""
        self._pairs: dict[tuple[Track, Track], Together] = {}

    def is_open(self, track: Track) -> bool:
        """Whether somebody may have been exchanged with somebody else."""
        return any(pair.is_open and track in pair.tracks for pair in self._pairs.values())

    def see(self, tracks: Sequence[Track], now_s: float) -> list[Finding]:
        """Those who are there: who is told now to be exchanged, or not, or that it is open."""
        step_s = now_s - self._poses[-1][0] if self._poses else 0.0
        while len(self._poses) > 1 and self._poses[1][0] <= now_s - _MIXED_S:
            self._poses.popleft()
        if self._poses and self._poses[0][0] <= now_s - _MIXED_S:
            self._tell(tracks, self._poses[0][1], now_s, step_s)
        self._poses.append((now_s, {track: track.pose for track in tracks}))
        return [finding for pair in list(self._pairs.values()) for finding in self._settled(pair, tracks, now_s)]

    def finish(self) -> list[Finding]:
        """No image follows: of whom it is still open."""
        pairs, self._pairs = self._pairs, {}
        return [Finding(Settled.PERHAPS, pair, pair.log_odds) for pair in pairs.values() if _is_unsaid(pair)]

    def _tell(self, tracks: Sequence[Track], before: dict[Track, PoseFilters], now_s: float, step_s: float) -> None:
        for pair in combinations([track for track in tracks if track in before], 2):
            if np.linalg.norm(pair[0].middle_m - pair[1].middle_m) > _NEAR_M:
                continue
            odds, together = kept_log_odds(pair, [before[track] for track in pair], now_s), self._pairs.get(pair)
            if together is None and odds < _TOGETHER:
                together = self._pairs[pair] = Together(pair, now_s, now_s, (_known(pair[0]), _known(pair[1])))
            if together is None:
                continue
            if odds < _TOGETHER:
                if together.has_parted:
                    together.meet_again()
                together.tell(odds, now_s, step_s)
            elif not all(_is_seen(track, now_s) for track in pair):
                together.until_s = now_s

    def _settled(self, pair: Together, tracks: Sequence[Track], now_s: float) -> list[Finding]:
        is_there = [track in tracks for track in pair.tracks]
        if not pair.has_parted:
            if all(is_there) and now_s < pair.until_s + _PARTED_S:
                return []
            if not pair.is_open:
                del self._pairs[pair.tracks]
                return []
            pair.has_parted = True
            for track in pair.tracks:
                # What was learned meanwhile may be of either.
                track.likeness = Likeness(track.likeness.skeleton, MeanAppearance(track.likeness.looks.resemblance))
            return [Finding(Settled.PERHAPS, pair, pair.log_odds)]
        log_odds = pair.log_odds_after(self._builds)
        is_told, is_exchanged = abs(log_odds) >= RECOGNISED, log_odds > 0
        if not is_told or pair.told is None or pair.told[0] != is_exchanged:
            pair.told = (is_exchanged, now_s) if is_told else None
        is_told = pair.told is not None and now_s >= pair.told[1] + _POSE_S
        if not is_told and any(is_there):
            return []
        del self._pairs[pair.tracks]
        for track, before in zip(pair.tracks, pair.before[:: -1 if is_exchanged else 1], strict=True):
            track.likeness.join(before)
        settled = Settled.EXCHANGED if is_exchanged else Settled.KEPT
        return [Finding(settled, pair, log_odds)] if is_told else []


def kept_log_odds(tracks: Sequence[Track], before: Sequence[PoseFilters], now_s: float) -> float:
    """Log odds that two who are followed are on their own bodies, against that they are on each other's.

    Args:
        tracks: both.
        before: their poses, when what is detected now was not yet mixed up.
        now_s: time.
    """
    expected = PoseFilters.stacked(list(before)).predicted(now_s)
    now = PoseFilters.stacked([track.pose for track in tracks])
    seen = [n for n, track in enumerate(tracks) if _is_seen(track, now_s)]
    if not seen:
        return np.inf
    off_m = now.positions_m[None, seen] - expected.positions_m[:, None]
    covariance_m2 = expected.covariance[:, None, :, :3, :3] + now.covariance[None, seen, :, :3, :3]
    distance2 = np.einsum("...i,...i->...", off_m, np.linalg.solve(covariance_m2, off_m[..., None])[..., 0])
    density = -0.5 * (distance2 + np.linalg.slogdet(covariance_m2)[1]).mean(axis=-1)
    kept = sum(density[n, k] - density[1 - n, k] for k, n in enumerate(seen))
    return float(INDEPENDENT_JOINTS * kept)


def _is_seen(track: Track, now_s: float) -> bool:
    return track.seen_s > now_s - SAME_MOMENT_S


def _is_unsaid(pair: Together) -> bool:
    return pair.is_open and not pair.has_parted


def _known(track: Track) -> Likeness:
    """What is known of somebody now, whatever is learned later."""
    likeness = copy.copy(track.likeness)
    likeness.looks = copy.copy(likeness.looks)
    return likeness
