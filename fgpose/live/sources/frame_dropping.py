"""When a source should leave images out, because the computer does not keep up with it."""

from __future__ import annotations

import time
from collections.abc import Callable
from enum import Enum

# An image that is later than this is of no use to most estimates.
_LATE_S = 0.3
# What a network held back comes all at once and is soon worked off; a computer that is too slow stays late for so long.
_STAYS_S, _STAYS_FAR_S = 0.5, 2.0


class Dropping(Enum):
    """What to leave out."""

    NONE = 0
    SOME = 1
    """What others do not depend on."""
    MOST = 2
    """Whatever can be."""


class Lateness:
    """Follows how late the images of a source are."""

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s = now_s
        self._late_since_s: float | None = None

    def dropping(self, late_s: float) -> Dropping:
        """After an image that arrived so late."""
        now_s = self._now_s()
        if late_s < _LATE_S:
            self._late_since_s = None
            return Dropping.NONE
        if self._late_since_s is None:
            self._late_since_s = now_s
        stays_s = now_s - self._late_since_s
        return Dropping.MOST if stays_s > _STAYS_FAR_S else Dropping.SOME if stays_s > _STAYS_S else Dropping.NONE
