"""The life of somebody who is followed: tentative, confirmed, coasting, lost, recognised again, ended."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from jaxtyping import Float

from fgpose.association.identity import Likeness, Passage
from fgpose.association.pose_filter import PoseFilters
from fgpose.correspondences import NOBODY
from fgpose.trajectory import Estimate

# How long after being confirmed somebody may be recognised: by then the lengths of the bones are known.
_RECOGNISED_WITHIN_S = 3.0


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
    """confirmed, found again, lost, recognised or merged."""
    reason: str
    became: int | None = None
    """Of who is recognised or merged: whom the number of person meant all along, by their own number. It is not used
    again. None: the number has not changed, or the results have the number from the start."""


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
    cameras: set[str]
    """Those that have detected them."""
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
        self.founded_m = self.middle_m

    @property
    def is_confirmed(self) -> bool:
        return self.state in (TrackState.CONFIRMED, TrackState.COASTING)

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


@dataclass(frozen=True, eq=False)
class Tracked:
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
    """Whether they may still be recognised as somebody who was here before, so that the number may change."""
    former: int | None = None
    """Their number in the updates before they were recognised; it is not used again. None: it has not changed."""
