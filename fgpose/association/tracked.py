"""Somebody in the room, as the tracker gives them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fgpose.association.track import TrackState
from fgpose.trajectory import Estimate


@dataclass(frozen=True, eq=False)
class Tracked:
    """Somebody who is in the room."""

    person: int
    """Their number. It changes at most once, when they are recognised as somebody who was here before; see events."""
    state: TrackState
    """CONFIRMED, or COASTING where no camera detects them at the moment."""
    estimate: Estimate
    """Its frame counts the updates since they were confirmed."""
    seen: Mapping[str, tuple[np.ndarray, np.ndarray]]
    """By the camera of each of the newest images that show them: of every joint the number of the detection (or NOBODY)
    and that of its joint there, as in people.Seen."""
