"""How rough motion is: how many times the variance is needed that the graph holds for it.

People move less roughly than white noise on the acceleration, or, in a hurry, more. What is wrong because of it is in
differences that noise alone does not explain: between a pose and its detections in batch
(error_components), and between the newest pose of a frame and its pose once the frames after it are
known, online.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from fgpose.estimation.noise import MEMORY_S
from fgpose.sampling import TIME_ROUNDING_S

TELLS_AGAIN_S = 0.2
"""Joints tell it anew after so long."""
_NINETIETH = 6.251 / 3  # of chi-squared with three degrees of freedom, in their number
_MOST, _PRIOR_MEASUREMENTS = 30.0, 50.0  # so many measurements tell more than the graph
# At first poses move because lengths, biases and hallucinations are found.
_SETTLES_S = 1.0


def roughness(
    found_m2: Float[np.ndarray, " joint"],
    noise_m2: Float[np.ndarray, " joint"],
    expected_m2: Float[np.ndarray, " joint"],
    measurements: float,
) -> float:
    """How many times what is expected of motion is needed besides the noise, that squares are as large as those found;
    drawn towards 1. Of all, the largest tenth does not count: that may be occlusions that were not noticed.

    Args:
        found_m2: squared differences.
        noise_m2, expected_m2: their expectations from the errors of detections and from motion as the graph takes it;
            this one is positive.
        measurements: how many of them are independent.
    """
    # Each joint asks for so much: found = _NINETIETH (noise + times expected).
    times = float(np.quantile((found_m2 / _NINETIETH - noise_m2) / expected_m2, 0.9))
    return (measurements * min(max(times, 0.0), _MOST) + _PRIOR_MEASUREMENTS) / (measurements + _PRIOR_MEASUREMENTS)


@dataclass(frozen=True, eq=False)
class NewestPose:
    """The pose of a frame while it was the newest, and how far later frames should move it."""

    positions_m: Float[np.ndarray, "joint 3"]
    noise_m2: Float[np.ndarray, " joint"]
    """Variance of its difference from the lagged pose, from errors of the detections; NaN where it tells nothing."""
    motion_m2: Float[np.ndarray, " joint"]
    """The same from motion, as rough as the graph takes it."""


class RunningRoughness:
    """The roughness of all joints together, learned from how far poses move until they are one lag old."""

    value: float
    """Learned so far."""

    def __init__(self) -> None:
        self.value = 1.0
        self._newest: dict[int, NewestPose] = {}
        self._found: deque[Float[np.ndarray, "3 joint"]] = deque(maxlen=int(MEMORY_S / TELLS_AGAIN_S))
        self._next_s: float | None = None  # None before the first frame

    def is_wanted(self, frame: int, time_s: float) -> bool:
        """Whether the newest frame is to be noted, also where that was done before another image joined it."""
        if self._next_s is None:
            self._next_s = time_s + _SETTLES_S + TELLS_AGAIN_S
        return frame in self._newest or time_s >= self._next_s - TIME_ROUNDING_S

    def note(self, frame: int, time_s: float, pose: NewestPose) -> None:
        """Take the newest frame, in place of what was noted of it before."""
        self._newest[frame], self._next_s = pose, time_s + TELLS_AGAIN_S

    def compare(self, frame: int, positions_m: Float[np.ndarray, "joint 3"], known: Bool[np.ndarray, " joint"]) -> None:
        """Take the pose of a frame once it is one lag old, of its well-known joints, if it was noted."""
        newest = self._newest.pop(frame, None)
        if newest is None:
            return
        found_m2 = np.sum((newest.positions_m - positions_m) ** 2, axis=-1)
        of_joints = np.stack([found_m2, newest.noise_m2, newest.motion_m2])
        tells = known & np.isfinite(of_joints).all(axis=0) & (newest.motion_m2 > 0)
        self._found.append(of_joints[:, tells])
        found = np.concatenate([*self._found], axis=1)
        if found.size:
            self.value = roughness(*found, measurements=float(found.shape[1]))
