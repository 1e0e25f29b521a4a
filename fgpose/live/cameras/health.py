"""What can be said of a camera from how its images come."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from itertools import takewhile
from statistics import median

import numpy as np

from fgpose.live.frame import CameraState

# Nothing for so long, and for so many of its intervals: lost.
_SILENT_S, _SILENT_IMAGES = 0.5, 5
# Before two images say how long an interval is.
_FIRST_SILENT_S = 2.0
# Messages that come at least so often say why no image does.
_REFUSED_S = 2.0
# Rates and lateness are of so long, and of at least as many images: what they tell is noticed within a second.
_RECENT_S, _RECENT_IMAGES = 0.9, 5
# Cameras fall to half of their rate in the dark.
_SLOW_SHARE = 0.7
# The usual rate is the median over windows of two seconds, of ten minutes; a stall and its backlog do not change it.
_WINDOW_S, _N_WINDOWS, _FEWEST_WINDOWS = 2.0, 300, 3
# More than an occasional error of the decoder.
_DAMAGED_SHARE = 0.2
# A fault is over when it has been away for so long: states do not flicker.
_OVER_S = 1.0
# Nobody looks for so long only where this computer does something else, which is no fault of a camera. It may be that
# who should look hangs, so that not more than this is excused.
_UNATTENDED_S, _MOST_UNATTENDED_S = 0.5, 2.0
# More images than come in the seconds that are looked back.
_MANY = 2048

_STATES = {
    "connecting": CameraState.RECONNECTING,
    "failed": CameraState.RECONNECTING,
    "ended": CameraState.LOST,
    "refused": CameraState.LOST,
    "silent": CameraState.LOST,
    "black": CameraState.DOUBTFUL,
    "frozen": CameraState.DOUBTFUL,
    "garbled": CameraState.DOUBTFUL,
    "moved": CameraState.DOUBTFUL,
    "clock": CameraState.DOUBTFUL,
    "contested": CameraState.DOUBTFUL,
    "slow": CameraState.LATE,
    "late": CameraState.LATE,
}
"""Faults, the gravest first: it gives the state."""


@dataclass(frozen=True)
class CameraVerdict:
    """A camera now."""

    state: CameraState
    fault: str = ""
    """The gravest, one of those that have names; empty where the state is ok."""
    reason: str = ""
    """All faults in words."""


_OK = CameraVerdict(CameraState.OK)


class Health:
    """Counts and times the images of one camera, and remembers what was found in them.

    Args:
        fps: images a second that it should give; 0: those that it usually gives.
        late_s: images that arrive this long after they were taken are late.
    """

    def __init__(self, fps: float, late_s: float) -> None:
        self._late_s = late_s
        self._usual_hz, self._learns_rate = fps, not fps
        """0 if it is not known yet."""
        self._arrivals: deque[tuple[float, float, bool]] = deque(maxlen=_MANY)
        self._windows: deque[int] = deque(maxlen=_N_WINDOWS)
        self._window_end_s = -np.inf
        self._n_in_window = 0
        self._flows_since_s = -np.inf
        self._looked_s, self._unattended_s = np.nan, 0.0
        """When somebody looked last, and for how long nobody did since the newest image came."""
        self._fixed: tuple[str, str] | None = ("connecting", "connecting")
        self._seen: dict[str, tuple[float, str]] = {}
        self._refused_s, self._refusal = -np.inf, ""

    def connected(self, now_s: float) -> None:
        """Its source was opened; it counts as connected with its first image."""
        self._flows_since_s, self._window_end_s = now_s, -np.inf

    def failed(self, reason: str) -> None:
        """Its source failed and is opened again."""
        self._fixed = "failed", reason

    def ended(self, reason: str) -> None:
        """Nothing more will come."""
        self._fixed = "ended", reason

    def add(self, arrived_s: float, captured_s: float, faults: dict[str, str], *, is_damaged: bool) -> None:
        """An image has arrived, in which these faults were found."""
        self._fixed, self._unattended_s = None, 0.0
        if arrived_s - self._last_s > self._silent_s():
            self._flows_since_s, self._window_end_s = arrived_s, -np.inf
        self._arrivals.append((arrived_s, arrived_s - captured_s, is_damaged))
        self._count(arrived_s)
        for name, reason in faults.items():
            self._seen[name] = arrived_s, reason

    def look(self, now_s: float) -> None:
        """Somebody looks, as they do several times a second; time in which nobody did is not silence of the camera."""
        self._unattended_s += self._unlooked_s(now_s)
        self._looked_s = now_s

    def saw(self, fault: str, reason: str, now_s: float) -> None:
        """A fault that no image shows."""
        self._seen[fault] = now_s, reason

    def refused(self, reason: str, now_s: float) -> None:
        """A message was refused."""
        self._refused_s, self._refusal = now_s, reason

    def rate_hz(self, now_s: float) -> float:
        """Of images over the last second, or longer if they are rare."""
        since_s = max(now_s - self._recent_s(), self._flows_since_s)
        n = len(self._after(since_s))
        return n / (now_s - since_s) if now_s > since_s else 0.0

    def verdict(self, now_s: float) -> CameraVerdict:
        """Its state at a time that is not before the newest image."""
        if self._fixed is not None:
            is_refused = self._fixed[0] == "connecting" and now_s - self._refused_s <= _REFUSED_S
            fault, reason = ("refused", self._refusal) if is_refused else self._fixed
            return CameraVerdict(_STATES[fault], fault, reason)
        faults = self._faults_of_times(now_s)
        if not faults and not self._seen:
            return _OK
        self._seen |= {name: (now_s, reason) for name, reason in faults.items()}
        for name in {"silent", "refused"} - faults.keys():
            self._seen.pop(name, None)
        self._seen = {name: seen for name, seen in self._seen.items() if now_s - seen[0] < _OVER_S}
        if not self._seen:
            return _OK
        order = [name for name in _STATES if name in self._seen]
        return CameraVerdict(_STATES[order[0]], order[0], "; ".join(self._seen[name][1] for name in order))

    @property
    def _last_s(self) -> float:
        """When the newest image arrived, or the source was opened."""
        return max(self._arrivals[-1][0] if self._arrivals else -np.inf, self._flows_since_s)

    def _unlooked_s(self, now_s: float) -> float:
        """Since somebody looked last, or the newest image came, where that is longer than it should be."""
        since_s = now_s - np.fmax(self._looked_s, self._last_s)
        return float(since_s) if np.isfinite(self._looked_s) and since_s > _UNATTENDED_S else 0.0

    def _silent_s(self) -> float:
        """Nothing for longer than this is a fault."""
        if self._usual_hz:
            return max(_SILENT_S, _SILENT_IMAGES / self._usual_hz)
        arrivals_s = [arrived_s for arrived_s, _, _ in self._arrivals if arrived_s >= self._flows_since_s]
        if len(arrivals_s) < 2:
            return _FIRST_SILENT_S
        interval_s = (arrivals_s[-1] - arrivals_s[0]) / (len(arrivals_s) - 1)
        return max(_SILENT_S, _SILENT_IMAGES * interval_s)

    def _recent_s(self) -> float:
        return max(_RECENT_S, _RECENT_IMAGES / self._usual_hz) if self._usual_hz else _RECENT_S

    def _after(self, since_s: float) -> list[tuple[float, float, bool]]:
        """Images that came after a time, the newest first."""
        return list(takewhile(lambda image: image[0] > since_s, reversed(self._arrivals)))

    def _count(self, arrived_s: float) -> None:
        if arrived_s >= self._window_end_s:
            is_whole = arrived_s < self._window_end_s + _WINDOW_S
            if is_whole and "slow" not in self._seen and self._n_in_window:
                self._windows.append(self._n_in_window)
                if self._learns_rate and len(self._windows) >= _FEWEST_WINDOWS:
                    self._usual_hz = median(self._windows) / _WINDOW_S
            self._window_end_s = (self._window_end_s if is_whole else arrived_s) + _WINDOW_S
            self._n_in_window = 0
        self._n_in_window += 1

    def _faults_of_times(self, now_s: float) -> dict[str, str]:
        faults = {}
        usual_hz, last_s, recent_s = self._usual_hz, self._last_s, self._recent_s()
        excused_s = min(self._unattended_s + self._unlooked_s(now_s), _MOST_UNATTENDED_S)
        if now_s - last_s - excused_s > self._silent_s():
            is_refused = now_s - self._refused_s <= max(_REFUSED_S, self._silent_s())
            return {"refused": self._refusal} if is_refused else {"silent": "no image comes"}
        if usual_hz and last_s - self._flows_since_s > 2 * recent_s:
            # Up to the newest image: what comes after it is silence.
            rate_hz = self.rate_hz(last_s)
            if rate_hz < _SLOW_SHARE * usual_hz:
                faults["slow"] = f"{rate_hz:.1f} images a second instead of {usual_hz:.1f}"
        # What came before a silence says nothing of what comes after it.
        recent = [image for image in self._after(now_s - recent_s) if image[0] >= self._flows_since_s]
        if not recent:
            return faults
        late_s = median([delay_s for _, delay_s, _ in recent])
        if late_s > self._late_s:
            faults["late"] = f"images come {late_s:.2f} s after they were taken"
        damaged = sum([is_damaged for _, _, is_damaged in recent]) / len(recent)
        if damaged > _DAMAGED_SHARE:
            faults["garbled"] = f"{damaged:.0%} of the images are damaged"
        return faults
