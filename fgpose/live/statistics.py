"""What happened while a live system ran."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from fgpose.live.frame import CameraState, CameraStatus, LiveFrame

LONGEST_MS = 5000
"""Latencies are counted in steps of a millisecond, and what is longer than this together: memory does not grow."""


class LiveStatistics:
    """Latencies, and how long each camera was in each state. Memory does not grow with time."""

    def __init__(self, camera_names: Sequence[str]) -> None:
        self.n_frames = 0
        self._latency_ms = np.zeros(LONGEST_MS + 1, dtype=int)
        self._image_s = -np.inf
        self._state_s: dict[str, defaultdict[CameraState, float]] = {name: defaultdict(float) for name in camera_names}
        self._published_s: float | None = None
        self.cameras: tuple[CameraStatus, ...] = ()
        """As they were last."""

    def add(self, frame: LiveFrame) -> None:
        """A frame that was published."""
        self.n_frames += 1
        if frame.time_s > self._image_s and any(camera.n_used for camera in frame.cameras):
            self._image_s = frame.time_s
            self._latency_ms[int(min(max(1e3 * frame.age_s, 0), LONGEST_MS))] += 1
        if self._published_s is not None:
            for camera in frame.cameras:
                self._state_s[camera.name][camera.state] += frame.published_s - self._published_s
        self._published_s, self.cameras = frame.published_s, frame.cameras

    def latency_ms(self, percent: float) -> float:
        """Percentile of the time from an image to the first frame that has it; inf: longer than LONGEST_MS, NaN: there
        was none."""
        counts = np.cumsum(self._latency_ms)
        if not counts[-1]:
            return np.nan
        latency_ms = float(np.searchsorted(counts, percent / 100 * counts[-1]))
        return latency_ms if latency_ms < LONGEST_MS else np.inf

    def seconds_in(self, camera: str, state: CameraState) -> float:
        """How long a camera was in a state."""
        return float(self._state_s[camera][state])
