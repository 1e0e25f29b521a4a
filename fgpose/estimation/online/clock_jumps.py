"""Times that are far from all before: one wrong stamp, or a clock that was set."""

from __future__ import annotations

from collections import deque

import numpy as np
from jaxtyping import Float

FAR_S = 60.0
"""From all others: nobody who was followed is still there, and no camera is so slow."""
ENOUGH_OF_ONE = 10
"""Where nothing else comes, so many that are far from the others are believed."""


class Ahead:
    """Frames and images that are far later than all before. For one wrong stamp all others would be too late: a frame
    is believed when the next is later still, an image of one camera when another camera has one of about that time. A
    frame has one stamp, so its cameras do not confirm each other."""

    def __init__(self, camera_names: tuple[str, ...]) -> None:
        self._names, self._n_agreeing = camera_names, min(2, len(camera_names))
        self._waiting: deque[tuple[frozenset[int], float]] = deque(maxlen=ENOUGH_OF_ONE)

    def check(self, taken_s: Float[np.ndarray, " camera"], newest_s: float) -> None:
        """Of images at these times (NaN: there is none), after a frame of another; -inf: none. Raises ValueError where
        it is not believed yet."""
        cameras, time_s = frozenset(np.flatnonzero(np.isfinite(taken_s)).tolist()), float(np.fmin.reduce(taken_s))
        if not time_s > newest_s + FAR_S > -np.inf:
            self._waiting.clear()
            return
        before = [each for each in self._waiting if each[1] != time_s or not each[0] & cameras]
        self._waiting.append((cameras, time_s))
        near = [own for own, other_s in before if abs(other_s - time_s) <= FAR_S]
        if not any(self._agree(cameras, time_s, *each) for each in before) and len(near) + 1 < ENOUGH_OF_ONE:
            is_frame = len(cameras) >= self._n_agreeing
            what = "a frame" if is_frame else f"camera {self._names[min(cameras)]}: its image"
            when = "the next frame is later still" if is_frame else "another camera has one of that time"
            raise ValueError(
                f"{what} at {time_s:.13g} s is {time_s - newest_s:.6g} s after all before; it was not used, and is "
                f"believed when {when}"
            )

    def _agree(self, cameras: frozenset[int], time_s: float, before: frozenset[int], before_s: float) -> bool:
        if min(len(cameras), len(before)) >= self._n_agreeing:
            return before_s < time_s
        return len(cameras | before) >= self._n_agreeing and abs(time_s - before_s) <= FAR_S


class SetBack:
    """Whether the clock was set back: one after the other, frames are far older than the newest and follow each
    other. Those of a camera that is late come between others that are not."""

    def __init__(self) -> None:
        self._older_s: list[float] = []

    def is_seen(self, time_s: float, newest_s: float) -> bool:
        """With a frame or an image at this time, after a frame of another; -inf: none."""
        if not time_s < newest_s - FAR_S:
            self._older_s = []
        elif not self._older_s or abs(time_s - self._older_s[-1]) > FAR_S:
            self._older_s = [time_s]
        elif time_s > self._older_s[-1]:
            self._older_s = [*self._older_s[1 - ENOUGH_OF_ONE :], time_s]
        return len(self._older_s) == ENOUGH_OF_ONE


SET_BACK = "the clock was set back by about {by_s:.6g} s: what was before is forgotten, and estimates begin anew"
"""What is warned of."""
