"""When somebody was there: what the lives of tracks say of every frame."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from jaxtyping import Int

from fgpose.association.recording import Association
from fgpose.association.track import TrackState
from fgpose.association.tracked import Tracked
from fgpose.people import NOBODY
from fgpose.sampling import nearest


class Presence(IntEnum):
    """Where somebody is in a frame of the recording."""

    OUTSIDE = 0
    """Before the first or after the last frame in which a camera detects them."""
    SEEN = 1
    """At least one camera detects them."""
    PREDICTED = 2
    """No camera detects them, and they are still followed."""
    AWAY = 3
    """They were lost, and will be found again."""


def presence(association: Association, person: int) -> Int[np.ndarray, " frame"]:
    """Of one person in every frame of the recording, values of Presence. Raises KeyError if there is no such person."""
    seen, time_s = association.people[person], association.frames.frame_time_s
    state = np.full(len(time_s), Presence.OUTSIDE)
    detected = (seen.detection != NOBODY).any(axis=(1, 2))
    state[seen.frames] = np.where(detected, Presence.SEEN, Presence.PREDICTED)
    lost_s = [event.time_s for event in association.events if event.person == person and event.what == "lost"]
    for lost in nearest(np.array(lost_s), time_s).tolist():
        begin = lost + int(state[lost] == Presence.SEEN)
        again = np.flatnonzero(state[begin:] == Presence.SEEN)
        if len(again):
            state[begin : begin + again[0]] = Presence.AWAY
    return state


def presence_of_tracked(tracked: Tracked) -> Presence:
    """Of somebody who is in the room, live: whether who is lost will be found again is not known."""
    return Presence.PREDICTED if tracked.state is TrackState.COASTING else Presence.SEEN
