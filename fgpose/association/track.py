"""The life of somebody who is followed: tentative, confirmed, coasting, lost, recognised again, ended."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from jaxtyping import Bool, Float

from fgpose.association.identity.likeness import Likeness, Passage
from fgpose.association.identity.sides import Sides
from fgpose.association.pose_filter import PoseFilters
from fgpose.correspondences import NOBODY
from fgpose.shown import Shown
from fgpose.trajectory import Estimate

SAME_MOMENT_S = 0.05
"""Older images of other cameras are of the same moment for somebody who walks (5 cm at 1 m/s)."""
COASTING_S = 0.1
"""Without a detection for longer, the pose is called predicted."""
# Errors of detections are correlated over about so much time: images within it tell once.
_CORRELATED_S = 0.1
# A detector that misses somebody misses them for about so long.
_MISSED_S = 0.3
# Nobody is so certain that being absent for a second would not count.
_MAX_SCORE = 30.0
# How far somebody is found again from where they are predicted, and from where two cameras agreed on them: the body may
# have turned round.
_FOUND_AGAIN_M, _WALKS_MPS, _HURRIES_MPS = 0.3, 1.0, 3.0
_ONE_BODY_M = 0.2  # the middles of two bodies are farther apart
# How long after being confirmed somebody may be recognised: by then the lengths of the bones are known.
_RECOGNISED_WITHIN_S = 3.0

# What a track says of who somebody is; their body is in the likeness.
_WHO = ("number", "person", "founded_s", "founded_m", "confirmed_s", "is_recognised", "former")


class TrackState(Enum):
    """Where somebody is in the life of a track."""

    TENTATIVE = "tentative"
    """Some views agree on a body; not often enough yet to rule out that it is by chance."""
    CONFIRMED = "confirmed"
    COASTING = "coasting"
    """Confirmed, and no camera detects them at the moment: the pose is predicted."""
    ENDED = "ended"
    """Not followed any more. Who was confirmed is lost, and may be recognised."""


@dataclass(frozen=True)
class TrackEvent:
    """A change in the life of a track, and why."""

    time_s: float
    person: int
    what: str
    """confirmed, found again, lost, recognised, doubted (whether they are who they were recognised as), merged, perhaps
    exchanged, exchanged, not exchanged, or sides exchanged (left and right were called each other since the time in the
    reason; results of a recording are right throughout)."""
    reason: str
    became: int | None = None
    """Of who is recognised or merged: whom the number of person meant all along, by their own number. It is not used
    again. None: the number has not changed, or the results have the number from the start."""
    beside: int | None = None
    """With whom they may have been exchanged, or were, as they were very near each other; both have such an event. Of a
    recording the results have the right numbers throughout. Live nothing changes: since about the time in the reason,
    either number means whom the other meant before."""


@dataclass(eq=False)
class Track:
    """Somebody who is followed."""

    number: int
    pose: PoseFilters
    score: float
    """Log of the ratio of probabilities that somebody is there, against that the detections agree by chance (sequential
    probability ratio, Wald 1945; of tracks: Sittler 1964)."""
    founded_s: float
    seen_s: float
    """When a camera last detected them."""
    shown_s: dict[str, float]
    """When each camera last detected them, of those that have."""
    likeness: Likeness
    absent: float = 0.0
    """Log of the probability that cameras have missed them, although they were there, since one last detected them."""
    person: int = NOBODY
    """Who it is; NOBODY until confirmed."""
    state: TrackState = TrackState.TENTATIVE
    confirmed_s: float = np.inf
    is_recognised: bool = False
    former: int | None = None
    """See Tracked."""
    scored_s: dict[str, float] = field(default_factory=dict)
    """When each camera last told for or against them."""
    near_s: dict[int, float] = field(default_factory=dict)
    """Since when they are at the place of another track, by its number."""
    apart_from: set[int] = field(default_factory=set)
    """Numbers of those who were seen beside them in one image."""

    def __post_init__(self) -> None:
        self.founded_m = self.agreed_m = self.middle_m
        self.sides = Sides(self.founded_s - SAME_MOMENT_S)
        self.agreed_s = self.founded_s
        """When enough cameras to tell where last detected them at once; -inf if none did for a while since."""

    def told(
        self,
        cameras: Sequence[str],
        times_s: Float[np.ndarray, " camera"],
        shows: Bool[np.ndarray, " camera"],
        gain: Float[np.ndarray, " camera"],
        n_agreeing: int,
    ) -> None:
        """The images of a moment show them or not.

        Args:
            cameras, times_s: of the images.
            shows: whether each does.
            gain: what it tells for or against that they are there.
            n_agreeing: so many cameras tell where.
        """
        before_s = self.seen_s
        for name, time_s, is_shown, tells in zip(cameras, times_s.tolist(), shows.tolist(), gain.tolist(), strict=True):
            since_s = max(time_s - self.scored_s.get(name, -np.inf), 0.0)
            tells *= min(since_s / (_CORRELATED_S if is_shown else _MISSED_S), 1.0)
            self.score = min(self.score + tells, _MAX_SCORE)
            self.scored_s[name] = max(time_s, self.scored_s.get(name, time_s))
            if is_shown:
                self.seen_s = max(self.seen_s, time_s)
                self.shown_s[name] = max(time_s, self.shown_s.get(name, time_s))
            else:
                self.absent += tells
        if not shows.any():
            return
        self.absent = 0.0
        if self.seen_s > before_s + _MISSED_S:
            self.agreed_s = -np.inf
        if len(self.at_once) >= n_agreeing:
            self.agreed_s, self.agreed_m = self.seen_s, self.middle_m

    def may_be(self, middle_m: Float[np.ndarray, " 3"], now_s: float, *, is_shown: bool) -> bool:
        """Whether a body may be theirs on which cameras agree: one that shows them and others, or others where no
        camera shows them."""
        if is_shown:
            off_m, most_m = middle_m - self.agreed_m, _FOUND_AGAIN_M + _HURRIES_MPS * (now_s - self.agreed_s)
        else:
            off_m, most_m = middle_m - self.middle_m, _FOUND_AGAIN_M + _WALKS_MPS * (now_s - self.seen_s)
        return bool(np.linalg.norm(off_m) < most_m)

    def drifts(self, now_s: float) -> bool:
        """Whether one camera alone has shown them for a while: then they drift along its rays."""
        return self.is_confirmed and COASTING_S < now_s - self.agreed_s < np.inf

    @property
    def at_once(self) -> list[str]:
        """The cameras that show them in the newest images."""
        return [name for name, shown_s in self.shown_s.items() if shown_s > self.seen_s - SAME_MOMENT_S]

    def found_again(self, pose: PoseFilters, shown_s: Mapping[str, float]) -> None:
        """Cameras agree on where they are."""
        self.pose, self.absent, self.seen_s = pose, 0.0, max(shown_s.values())
        self.sides = Sides(self.seen_s - SAME_MOMENT_S)
        self.shown_s |= shown_s
        self.agreed_s, self.agreed_m = self.seen_s, self.middle_m

    @property
    def is_confirmed(self) -> bool:
        return self.state in (TrackState.CONFIRMED, TrackState.COASTING)

    def exchange_numbers(self, other: Track) -> None:
        """Each is who the other was taken for."""
        for track, numbers in ((self, {other.number: self.number}), (other, {self.number: other.number})):
            track.apart_from = {numbers.get(number, number) for number in track.apart_from}
            track.near_s = {numbers.get(number, number): since_s for number, since_s in track.near_s.items()}
        for name in _WHO:
            own = getattr(self, name)
            setattr(self, name, getattr(other, name))
            setattr(other, name, own)

    def may_be_recognised(self, now_s: float) -> bool:
        """Whether it is still open who they are."""
        return not self.is_recognised and now_s <= self.confirmed_s + _RECOGNISED_WITHIN_S

    @property
    def passage(self) -> Passage:
        """From where they were founded to where they are."""
        return Passage(self.founded_s, self.founded_m, self.seen_s, self.middle_m, self.likeness)

    @property
    def middle_m(self) -> Float[np.ndarray, " 3"]:
        """Median of the joints."""
        return self.pose.middle_m[0]


def whose(
    tracks: Collection[Track], shown: Collection[Track], middle_m: Float[np.ndarray, " 3"], now_s: float
) -> Track | None:
    """Who a body is on which cameras agree: of those whom one of them alone shows, else of those who coast, the nearest
    who may have come there."""
    coasting = [track for track in tracks if track.seen_s < now_s - SAME_MOMENT_S]
    for some, is_shown in ((shown, True), (coasting, False)):
        # Who is shown may have ended since that image.
        confirmed = [track for track in some if track.is_confirmed]
        may_be = [track for track in confirmed if track.may_be(middle_m, now_s, is_shown=is_shown)]
        if may_be:
            return min(may_be, key=lambda track: float(np.linalg.norm(track.middle_m - middle_m)))
    return None


def at_one_place(one: Track, other: Track) -> bool:
    """Whether two bodies cannot both be there."""
    return bool(np.linalg.norm(one.middle_m - other.middle_m) <= _ONE_BODY_M)


def tell_apart(tracks: Sequence[Track], is_seen: Bool[np.ndarray, "camera track"]) -> None:
    """Who are seen in one image, each at a place of their own, are two, however near they come to each other."""
    numbers = {track.number for track in tracks}
    for k, track in enumerate(tracks):
        track.apart_from &= numbers
        if track.is_confirmed:
            track.apart_from |= {
                other.number
                for n, other in enumerate(tracks)
                if other.is_confirmed and (is_seen[:, k] & is_seen[:, n]).any() and not at_one_place(track, other)
            }


@dataclass(frozen=True, eq=False, repr=False)
class Tracked(Shown):
    """Somebody who is in the room, as the tracker gives them."""

    person: int
    """Their number. It changes at most once, when they are recognised as somebody who was here before; see former."""
    state: TrackState
    """CONFIRMED, or COASTING where no camera detects them at the moment."""
    estimate: Estimate
    """Its frame counts the updates since they were confirmed."""
    seen: Mapping[str, tuple[np.ndarray, np.ndarray]]
    """By the camera of each of the newest images that show them: of every joint the number of the detection (or NOBODY)
    and that of its joint there, as in people.Seen."""
    is_provisional: bool = False
    """Whether it is open who they are: they may still be recognised as somebody who was here before, so that the number
    may change; were, but not for certain yet; or may have been exchanged with somebody to whom they were very near."""
    former: int | None = None
    """Their number in the updates before they were recognised; it is not used again. None: it has not changed."""
