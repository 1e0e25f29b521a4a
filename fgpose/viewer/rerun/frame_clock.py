"""Which time the frames of a recording have, as far as they have been logged."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


class FrameClock:
    """Learns the frames of a recording as they are logged, in any order."""

    def __init__(self) -> None:
        self._time_s: dict[int, float] = {}
        self.last_frame = -1
        """The last that has been logged; -1: none has."""

    def learn(self, first_frame: int, time_s: Float[np.ndarray, " frame"]) -> None:
        """Times of frames from first_frame on."""
        frames = range(first_frame, first_frame + len(time_s))
        self._time_s |= dict(zip(frames, time_s.tolist(), strict=True))
        self.last_frame = max(self.last_frame, *frames, -1)

    def forget(self, frame: int) -> None:
        """Times of the frames before this one are not needed any more."""
        self._time_s = {known: time_s for known, time_s in self._time_s.items() if known >= frame}

    def time_s(self, frame: int) -> float:
        """Of a frame between the first that is known and the last; interpolated if it has not been logged."""
        if frame in self._time_s:
            return self._time_s[frame]
        known = sorted(self._time_s)
        return float(np.interp(frame, known, [self._time_s[each] for each in known]))
