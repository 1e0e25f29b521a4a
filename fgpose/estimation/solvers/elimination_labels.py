"""Labels that have GTSAM eliminate the frames of a window in the order of time; why they do, see fixed_lag."""

from __future__ import annotations

from collections import deque

import gtsam


class Labels:
    """Numbers of frames, increasing with time, by key. Kept from update to update: to make them anew takes as long as
    marginalising."""

    def __init__(self) -> None:
        self._map = gtsam.KeyGroupMap()
        self._newest: list[int] = []
        self._n_used = 0

    def of(self, frames: list[list[int]], limit: int) -> gtsam.KeyGroupMap:
        """Labels below the limit, which is no less than the number of frames."""
        grown_by_one = len(frames) > 1 and frames[-2] is self._newest
        if not grown_by_one or self._n_used >= limit:
            self._map.clear()
            self._n_used = 0
        for frame in frames[-1:] if self._n_used else frames:
            for key in frame:
                self._map.insert2(key, self._n_used)
            self._n_used += 1
        self._newest = frames[-1]
        return self._map

    def remove(self, keys: list[int]) -> None:
        for key in keys:
            self._map.erase(key)


def frames_of(keys: gtsam.KeySet, frames: list[list[int]]) -> list[list[int]]:
    """These keys by their frames, oldest first; hardly ever are they of other frames than the newest."""
    found: deque[list[int]] = deque()
    missing = len(keys)
    for frame in reversed(frames):
        if not missing:
            break
        own = [key for key in frame if key in keys]
        missing -= len(own)
        if own:
            found.appendleft(own)
    return list(found)
