"""What a camera's stamps are in Unix time, learned from when its images arrive."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from fgpose.live.cameras.lower_envelope import envelope_line, lower_hull

# Twenty minutes: where the fastest images are rare, jitter of 200 ms needs that long to leave 1 ms and 2 ppm. A crystal
# that gets warmer by some degrees changes by less meanwhile.
_WINDOW_S = 1200.0
# Of each second the fastest image is kept: within it 200 ppm are 0.2 ms.
_BUCKET_S = 1.0
# Crystals are specified to 20-100 ppm.
_DRIFT_SIGMA = 100e-6
# The same crystal some time later, at another temperature.
_KNOWN_DRIFT_SIGMA = 10e-6
_KNOWN_AFTER_S = 120.0
# More than the jitter of a network: the clock has jumped. A stream that starts late may catch up at first, but not by
# more than any source keeps.
_JUMP_S = 0.25
_SETTLED_S, _BACKLOG_S = 2.0, 10.0
# Images overtake each other by less. A clock that was set back by less looks the same at first: all of its images come
# late from then on, for so long.
_OVERTAKEN_S, _STAYS_BACK_S = 1.0, 2.0
# Before there are enough images to tell.
_FIRST_SIGMA_S = 0.1
_N_LOWEST = 10
# Of stamps and of arrivals.
_RESOLUTION_S = 1e-4
# A camera's clock that is synchronised puts its images before they arrive, but not long before.
_SYNCHRONISED_S = (-0.005, 0.5)
# A clock that was ahead is believed when it has not been for so long.
_BELIEVED_AFTER_S = 30.0
# Sender reports agree with each other better than this, unless the camera's time was set.
_SET_S = 0.1
# A clock that was set back is right again when its images come as early as before; jitter apart.
_AS_BEFORE_S = 0.05
# What SNTP, which most cameras have, reaches in a local network.
_SYNCHRONISED_SIGMA_S = 0.01
# Streams take 50 to 150 ms from the exposure to the arrival, where nobody has said how long; where somebody has, they
# have measured it with a display that changes every 5 to 17 ms.
_UNKNOWN_LATENCY_SIGMA_S, _KNOWN_LATENCY_SIGMA_S = 0.1, 0.01


ClockKind = Literal["auto", "own", "synchronised"]


@dataclass(frozen=True)
class Stamp:
    """What a source says of when an image was taken."""

    stamp_s: float
    """By a clock whose origin is anything; it may drift."""
    wall_s: float | None = None
    """Unix time by the camera's own clock, which may be wrong (RTCP)."""
    is_host_time: bool = False
    """The stamp is Unix time of this computer's Clock, which needs no model (drivers, paced files)."""


class ClockModel:
    """Offset and drift of a camera's stamps against the clock of this computer.

    An image arrives after it was taken. Unix time minus stamp is a line that has all (arrival - stamp) above it; the
    highest of these over the last twenty minutes is taken. So the stamp of the fastest image becomes its arrival; the
    least time from taking an image to its arrival cannot be seen in the arrivals and is given as latency_s.
    A camera that sends Unix time (RTCP) is believed if that agrees with the arrivals. Set back, it would agree too if
    images came later: its images keep the delays of before until it is seen to be right again.

    Args:
        latency_s: the least time from taking an image to its arrival: exposure, encoding, network, decoding.
        clock: of the camera. own: the Unix time that it sends tells nothing. synchronised: it is believed, and images
            that come late are late. auto: it is believed if it agrees with the arrivals.
    """

    def __init__(self, latency_s: float = 0.0, clock: ClockKind = "auto") -> None:
        self._latency_s, self._kind = latency_s, clock
        self._segment: _Segment | None = None
        self._drift, self._drift_sigma = 0.0, _DRIFT_SIGMA
        self._last: Stamp | None = None
        self._back_since_s: float | None = None
        """When an image came whose stamp is before that of another, until it is known why."""
        self._is_synchronised = False
        self._fast: deque[tuple[float, float]] = deque()
        """Arrivals and delays by the camera's own time, each the least from then on."""
        self._former_delay_s: float | None = None
        """The least delay by the camera's own time before it was set back; None: it was not, or it is right again."""
        self.unproven_s: float | None = None
        """By how much longer ago than its time says the newest image may have been taken: nothing tells whether the
        clock is behind or the images come late. None: nothing tells how late they come."""
        self.n_jumps = 0
        """Since the start."""
        self.jump_s = 0.0
        """By how much (stamp minus Unix time) jumped the last time."""

    def captured_s(self, stamp: Stamp | None, arrived_s: float) -> float:
        """Learn from an image; Unix time at which it was taken, not after its arrival unless the stamp is host time.

        Args:
            stamp: None if the source has none.
            arrived_s: Unix time.
        """
        if stamp is not None and self._kind == "own":
            stamp = replace(stamp, wall_s=None)
        captured_s = self._captured_s(stamp, arrived_s)
        self.unproven_s = self._unproven_s(stamp, captured_s)
        return captured_s

    def _unproven_s(self, stamp: Stamp | None, captured_s: float) -> float | None:
        if stamp is not None and (stamp.is_host_time or self._is_synchronised):
            return 0.0
        if stamp is not None and stamp.wall_s is not None and stamp.wall_s <= captured_s:
            return captured_s - stamp.wall_s
        return 0.0 if self._latency_s else None

    def _captured_s(self, stamp: Stamp | None, arrived_s: float) -> float:
        before, self._last = self._last, stamp
        if stamp is None:
            return arrived_s - self._latency_s
        if stamp.is_host_time:
            return stamp.stamp_s
        self._note_wall_jump(before, stamp)
        if before is not None and self._segment is not None and self._jumps(before, stamp, arrived_s):
            self._note_jump(self._segment.offset_s(before.stamp_s) - (arrived_s - stamp.stamp_s))
            self._end_segment()
        if self._segment is None:
            self._segment = _Segment(stamp.stamp_s, arrived_s - stamp.stamp_s, self._drift, self._drift_sigma)
        self._segment.add(stamp.stamp_s, arrived_s - stamp.stamp_s)
        self._is_synchronised = stamp.wall_s is not None and self._is_right(arrived_s, arrived_s - stamp.wall_s)
        if self._is_synchronised and stamp.wall_s is not None:
            return min(stamp.wall_s, arrived_s)
        return min(stamp.stamp_s + self._segment.offset_s(stamp.stamp_s) - self._least_delay_s, arrived_s)

    @property
    def _least_delay_s(self) -> float:
        """From taking an image to its arrival."""
        return self._latency_s or self._former_delay_s or 0.0

    def _is_right(self, arrived_s: float, delay_s: float) -> bool:
        """Whether the camera's own time is believed."""
        fastest_s = self._fastest_s(arrived_s, delay_s)
        if self._former_delay_s is not None and fastest_s <= self._former_delay_s + _AS_BEFORE_S:
            self._former_delay_s = None
        latest_s = np.inf if self._kind == "synchronised" else _SYNCHRONISED_S[1]
        return bool(_SYNCHRONISED_S[0] <= fastest_s <= latest_s) and self._former_delay_s is None

    def _note_jump(self, jump_s: float) -> None:
        self.n_jumps, self.jump_s = self.n_jumps + 1, jump_s
        if jump_s < 0 and self._is_synchronised and self._kind == "auto":
            self._former_delay_s = self._fast[0][1]
            self._fast.clear()

    def _fastest_s(self, arrived_s: float, delay_s: float) -> float:
        """The least delay of late by the camera's own time: a clock that was wrong may be right again."""
        while self._fast and self._fast[-1][1] >= delay_s:
            self._fast.pop()
        self._fast.append((arrived_s, delay_s))
        while self._fast[0][0] < arrived_s - _BELIEVED_AFTER_S:
            self._fast.popleft()
        return self._fast[0][1]

    def restart(self) -> None:
        """The source was opened again: its stamps may begin anew. The drift is kept."""
        self._end_segment()
        self._last = self._former_delay_s = None
        self._fast.clear()

    @property
    def offset_s(self) -> float | None:
        """What is added to the newest stamp to get Unix time; None without stamps."""
        if self._last is None:
            return None
        if self._last.is_host_time:
            return 0.0
        if self._is_synchronised and self._last.wall_s is not None:
            return self._last.wall_s - self._last.stamp_s
        return None if self._segment is None else self._segment.offset_s(self._last.stamp_s) - self._least_delay_s

    @property
    def sigma_s(self) -> float | None:
        """Of the offset, apart from the latency; None without stamps."""
        if self._last is None:
            return None
        if self._last.is_host_time:
            return 0.0
        if self._is_synchronised:
            return _SYNCHRONISED_SIGMA_S
        return None if self._segment is None else self._segment.sigma_s

    @property
    def time_sigma_s(self) -> float:
        """What the times of all images have in common is off by about this: offset and latency. The motion of those
        who are seen may tell more."""
        if self._last is not None and (self._last.is_host_time or self._is_synchronised):
            return self.sigma_s or 0.0
        latency_sigma_s = _KNOWN_LATENCY_SIGMA_S if self._latency_s else _UNKNOWN_LATENCY_SIGMA_S
        return float(np.hypot(latency_sigma_s, self.sigma_s or 0.0))

    @property
    def drift(self) -> float:
        """Seconds by which Unix time gains on the stamps, per second."""
        return self._drift if self._segment is None else self._segment.drift

    def _note_wall_jump(self, before: Stamp | None, stamp: Stamp) -> None:
        """The camera's own time may be set while its stamps go on."""
        if before is None or before.wall_s is None or stamp.wall_s is None:
            return
        change_s = (stamp.wall_s - stamp.stamp_s) - (before.wall_s - before.stamp_s)
        if abs(change_s) > _SET_S and stamp.stamp_s >= before.stamp_s:
            self._note_jump(change_s)

    def _jumps(self, before: Stamp, stamp: Stamp, arrived_s: float) -> bool:
        assert self._segment is not None
        early_s = self._segment.offset_s(stamp.stamp_s) - (arrived_s - stamp.stamp_s)
        if stamp.stamp_s < before.stamp_s - _OVERTAKEN_S or self._stays_back(before, stamp, arrived_s, -early_s):
            return True
        is_settled = self._segment.duration_s > _SETTLED_S
        return bool(early_s > (_JUMP_S if is_settled else _BACKLOG_S))

    def _stays_back(self, before: Stamp, stamp: Stamp, arrived_s: float, late_s: float) -> bool:
        """Whether the clock was set back a little: since then no image has come as early as those before. Until that is
        known images have the times of the old clock: they are older than the true ones, if anything."""
        if stamp.stamp_s < before.stamp_s and self._back_since_s is None:
            self._back_since_s = arrived_s
        if late_s < _JUMP_S:
            self._back_since_s = None
        return self._back_since_s is not None and arrived_s > self._back_since_s + _STAYS_BACK_S

    def _end_segment(self) -> None:
        self._back_since_s = None
        if self._segment is not None and self._segment.duration_s > _KNOWN_AFTER_S:
            self._drift, self._drift_sigma = self._segment.drift, _KNOWN_DRIFT_SIGMA
        self._segment = None


class _Segment:
    """Stamps of a clock that does not jump.

    x is time since the first stamp, y what the delay is more than that of the first image.
    """

    def __init__(self, stamp_s: float, delay_s: float, drift: float, drift_sigma: float) -> None:
        self._origin_s, self._delay_s = stamp_s, delay_s
        self._expected_drift, self._drift_sigma = drift, drift_sigma
        self._buckets = np.zeros((0, 5))
        """Of the images of each second: their number, the sums of their x and y, and those of the fastest."""
        self._hull = np.zeros((0, 2))
        """Of the fastest images of all these seconds, those on their lower hull."""
        self._recent: list[tuple[float, float]] = []
        self.drift, self._mean_x, self._height = drift, 0.0, 0.0
        self.sigma_s = _FIRST_SIGMA_S

    @property
    def duration_s(self) -> float:
        """Of what is in the window."""
        if not self._recent:
            return 0.0
        return self._recent[-1][0] - float(self._buckets[0, 3] if len(self._buckets) else self._recent[0][0])

    def offset_s(self, stamp_s: float) -> float:
        """Arrival minus stamp of the fastest image at the time of a stamp."""
        return self._delay_s + self._line(stamp_s - self._origin_s)

    def add(self, stamp_s: float, delay_s: float) -> None:
        x, y = stamp_s - self._origin_s, delay_s - self._delay_s
        closes = bool(self._recent) and x >= self._recent[0][0] + _BUCKET_S
        if closes:
            self._close_bucket()
        if not self._recent or x > self._recent[-1][0]:
            self._recent.append((x, y))
        if closes or y < self._line(x):
            self._fit()

    def _line(self, x: float) -> float:
        return self._height + self.drift * (x - self._mean_x)

    def _close_bucket(self) -> None:
        points = np.array(self._recent)
        lowest = points[np.argmin(points[:, 1] - self.drift * points[:, 0])]
        in_window = self._buckets[lowest[0] - self._buckets[:, 3] <= _WINDOW_S]
        before = self._hull if len(in_window) == len(self._buckets) else in_window[:, 3:]
        self._buckets = np.concatenate([in_window, [[len(points), *points.sum(axis=0), *lowest]]])
        candidates = np.concatenate([before, [lowest]])
        self._hull = candidates[lower_hull(candidates)]
        self._recent = []

    def _fit(self) -> None:
        recent = np.array(self._recent).reshape(-1, 2)
        n = float(self._buckets[:, 0].sum()) + len(recent)
        mean_x, mean_y = ((self._buckets[:, 1:3].sum(axis=0) + recent.sum(axis=0)) / n).tolist()
        mean_excess = max(mean_y - self._line(mean_x), _RESOLUTION_S)
        self.drift, self._height = envelope_line(
            np.concatenate([self._hull, recent]), mean_x, n / mean_excess, self._expected_drift, self._drift_sigma
        )
        self._mean_x = mean_x
        points = np.concatenate([self._buckets[:, 3:], recent])
        above = points[:, 1] - self._height - self.drift * (points[:, 0] - mean_x)
        if len(above) >= _N_LOWEST:
            # How far the lowest points are from each other tells how far below them the limit is: by a ninth of it if
            # delays are evenly distributed above it, by half of it if few are near it (triangular).
            gap = float(np.partition(above, _N_LOWEST - 1)[_N_LOWEST - 1])
            # At the end of the window the line is twice as uncertain as in its middle.
            half = 0.5 * self.duration_s
            self.sigma_s = float(np.sqrt(gap**2 + min(gap, half * self._drift_sigma) ** 2 + _RESOLUTION_S**2))
