"""The steps of a walker: where each foot stood, found by its speed alone, so that no vertical is needed yet."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int

from fgpose.calibration.from_people.world.anatomy import Anatomy
from fgpose.sampling import stretches

STEPS_AS_ONE = 4.0
"""A walker is seen from the same directions at many steps, so the errors of these are the same: so many are as one."""
# Statures per second: 0.35 m/s. A foot swings at 2 to 4 m/s; noise of 15 mm looks like 0.1 m/s over the window.
_STANDS = 0.2
_HALF_WINDOW_S = 0.1
_MIN_STANCE_S = 0.1
# One stance of a foot lasts 0.6 s in a slow walk. Of somebody who stays the next part counts as another one.
_MAX_STANCE_S = 1.0
# Parts of long recordings are left out: nobody knows what the foot did meanwhile.
_GAP_S = 0.3


@dataclass(frozen=True, eq=False)
class Steps:
    """Each time that a foot stood on the floor."""

    foot_m: Float[np.ndarray, "step 3"]
    """Where, in the gauge of the joints: middle of the points of the foot (Anatomy.feet_m), median over the stance."""
    lowest_m: Float[np.ndarray, "step part 3"]
    """Its points, each the median over the stance."""
    frame: Int[np.ndarray, " step"]
    """The middle one of the stance."""

    @staticmethod
    def of(
        joints_m: Float[np.ndarray, "frame joint 3"], time_s: Float[np.ndarray, " frame"], anatomy: Anatomy
    ) -> Steps:
        """All steps of a walk.

        Args:
            joints_m: of one walker, in any gauge and unit; NaN = missing.
            time_s: of the frames, increasing.
            anatomy: of the skeleton.
        """
        feet_m, stature = anatomy.feet_m(joints_m), anatomy.stature_m(joints_m)
        points, middles = [np.empty((0, *feet_m.shape[2:]))], []
        for side in (0, 1):
            speed = _speed(feet_m[:, side].mean(axis=1), time_s)
            for start, end in _stances(speed < _STANDS * stature, time_s):
                points.append(np.median(feet_m[None, start:end, side], axis=1))
                middles.append((start + end) // 2)
        lowest_m = np.concatenate(points)
        return Steps(lowest_m.mean(axis=1), lowest_m, np.array(middles, dtype=int))

    def __len__(self) -> int:
        return len(self.foot_m)


def _speed(points_m: Float[np.ndarray, "frame 3"], time_s: Float[np.ndarray, " frame"]) -> Float[np.ndarray, " frame"]:
    """Length of the velocity over 0.2 s; NaN where one of the two ends is missing."""
    after = np.searchsorted(time_s, time_s + _HALF_WINDOW_S, side="right") - 1
    before = np.searchsorted(time_s, time_s - _HALF_WINDOW_S)
    # At few frames per second the neighbours.
    after, before = np.maximum(after, np.arange(len(time_s)) + 1), np.minimum(before, np.arange(len(time_s)) - 1)
    inside = (before >= 0) & (after < len(time_s))
    after, before = np.minimum(after, len(time_s) - 1), np.maximum(before, 0)
    step_s = np.maximum(time_s[after] - time_s[before], 1e-9)
    speed = np.linalg.norm(points_m[after] - points_m[before], axis=-1) / step_s
    return np.where(inside & np.isfinite(points_m).all(axis=-1), speed, np.nan)


def _stances(stands: np.ndarray, time_s: Float[np.ndarray, " frame"]) -> list[tuple[int, int]]:
    """First frame and that after the last of each stance, in which no frames are missing; longer ones in parts."""
    gaps = np.flatnonzero(np.diff(time_s) > _GAP_S) + 1
    stances = []
    for first, last in stretches(stands):
        ends = [first, *gaps[(gaps > first) & (gaps < last)].tolist(), last]
        for start, end in pairwise(ends):
            lasts_s = time_s[end - 1] - time_s[start]
            if lasts_s < _MIN_STANCE_S:
                continue
            parts = np.linspace(start, end, int(np.ceil(lasts_s / _MAX_STANCE_S)) + 1).astype(int)
            stances += list(zip(parts[:-1].tolist(), parts[1:].tolist(), strict=True))
    return stances
