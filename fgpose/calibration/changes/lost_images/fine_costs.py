"""How badly two cameras agree at every lag, moment by moment: short enough to tell when images were lost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.calibration.changes.comparison import MAX_LAG_S, Comparison
from fgpose.calibration.changes.lag_costs import AT_ONCE, Blocks, SampleCosts, independent
from fgpose.calibration.changes.motion_share import displacements
from fgpose.calibration.changes.rays import Rays
from fgpose.freed_memory import hand_back
from fgpose.sampling import parts_of

MOMENT_S = 0.2
"""Errors of detections are correlated over 0.15 s."""
PER_IMAGE = 4
"""Steps of the lags in the time from image to image: clocks differ by any part of it, and lose whole ones."""
_LEAST_SAMPLES = 2
_MOST_MOMENTS = 1500  # of longer recordings than five minutes; bounds time and memory
# Rays of some joints that two cameras see in a moment tell its cost if there are so many, and half of those at the best
# lag.
_MIN_SEEN, _ENOUGH = 2, 0.5


@dataclass(frozen=True, eq=False)
class FineCosts:
    """Of each pair of cameras: minus the logarithm of how probable its angles are at each lag."""

    moments: Blocks
    step_s: float
    """Of the lags."""
    n_cameras: int
    cost: dict[tuple[int, int], Float[np.ndarray, "moment lag"]]
    """By how much later the second camera is than the first, by whose stamps the moments are. The lags are even and
    symmetric."""

    @property
    def n_lags(self) -> int:
        return next(iter(self.cost.values())).shape[1]

    def of_camera(
        self, c: int, lag: Int[np.ndarray, "camera moment"], others: list[int]
    ) -> Float[np.ndarray, "moment lag"]:
        """By how much later a camera is, beside others that are late by so much at each moment of the common clock."""
        total = np.zeros((self.moments.n_blocks, self.n_lags))
        numbers = np.arange(self.n_lags)
        for other in others:
            first, second = min(c, other), max(c, other)
            own = self.cost[first, second][self._rows(lag[first])]
            own = own if second == c else own[:, ::-1]
            at = np.clip(numbers - lag[other][:, None], 0, self.n_lags - 1)
            total += np.take_along_axis(own, at, axis=1)
        return total

    def total(self, lag: Int[np.ndarray, "camera moment"]) -> Float[np.ndarray, " moment"]:
        """Of all pairs, if cameras are late by so much, in steps."""
        total, middle = np.zeros(self.moments.n_blocks), self.n_lags // 2
        for (a, b), cost in self.cost.items():
            at = np.clip(lag[b] - lag[a] + middle, 0, self.n_lags - 1)
            total += cost[self._rows(lag[a]), at]
        return total

    def _rows(self, lag: Int[np.ndarray, " moment"]) -> Int[np.ndarray, " moment"]:
        """The moment by the stamps of a camera at each of the common clock."""
        begins_s = self.moments.time_s - 0.5 * self.moments.length_s
        rows = np.searchsorted(begins_s, self.moments.time_s - self.step_s * lag, side="right") - 1
        return np.clip(rows, 0, len(rows) - 1)


def fine_costs(compared: Comparison, n_parts: int) -> list[FineCosts]:
    """By some joints each, which err by themselves; in one part, or in several, of which each takes as much memory."""
    rays, seconds = compared.rays, compared.blocks
    moments = _moments(seconds, rays.time_s[seconds.index])
    n_lags = round(MAX_LAG_S / rays.step_s)
    step_s = compared.step_s / PER_IMAGE
    lag_s = step_s * np.arange(-int(MAX_LAG_S / step_s), int(MAX_LAG_S / step_s) + 1)
    grid_s = rays.step_s * np.arange(-n_lags, n_lags + 1)
    moved = displacements(rays, seconds.index)
    found: list[dict[tuple[int, int], Float[np.ndarray, "moment lag"]]] = [
        {} for _ in range(min(n_parts, rays.direction.shape[2]))
    ]
    for pair in combinations(range(rays.n_cameras), 2):
        of_parts = _of_pair(rays, seconds, pair, n_lags, moved[list(pair)], moments, n_parts)
        for of_part, of_moment in zip(found, of_parts, strict=True):
            of_part[pair] = _at(of_moment, grid_s, lag_s)
        hand_back()
    return [FineCosts(moments, step_s, rays.n_cameras, of_part) for of_part in found]


def _of_pair(
    rays: Rays,
    seconds: Blocks,
    pair: tuple[int, int],
    n_lags: int,
    moved: Float[np.ndarray, "2 sample joint 3"],
    moments: Blocks,
    n_parts: int,
) -> list[Float[np.ndarray, "moment lag"]]:
    """By each part of the joints."""
    samples = SampleCosts.of(rays, seconds, pair, n_lags, moved)
    joints = [slice(number, None, n_parts) for number in range(min(n_parts, moved.shape[2]))]
    sums = np.empty((len(joints), 3, len(seconds.index), samples.n_lags))
    for part in parts_of(len(seconds.index), AT_ONCE):
        counted, weight = samples.weighted(part)
        for own, of_samples in zip(joints, sums, strict=True):
            for of_kind, each in zip(of_samples, (counted, weight, weight > 0), strict=True):
                of_kind[part] = each[..., own].sum(axis=2, dtype=float)
    return [_by_moment(each, moments) * independent(seconds) for each in sums]


def together(parts: Sequence[FineCosts]) -> FineCosts:
    """Of all these joints."""
    cost = {pair: np.sum([each.cost[pair] for each in parts], axis=0) for pair in parts[0].cost}
    return replace(parts[0], cost=cost)


def _moments(seconds: Blocks, time_s: Float[np.ndarray, " sample"]) -> Blocks:
    """As short as they may be, each with some samples."""
    begin_s = float(time_s.min())
    duration_s = seconds.n_blocks * seconds.length_s
    length_s = max(MOMENT_S, _LEAST_SAMPLES * duration_s / len(seconds.index), duration_s / _MOST_MOMENTS)
    numbers, block = np.unique(((time_s - begin_s) / length_s).astype(int), return_inverse=True)
    return Blocks(seconds.index, block, begin_s + (numbers + 0.5) * length_s, length_s)


def _by_moment(sums: Float[np.ndarray, "3 sample lag"], moments: Blocks) -> Float[np.ndarray, "moment lag"]:
    """Sums of weighted costs, of weights and of their numbers, as if at every lag as much were seen as at the one where
    most is. Where little is seen, as past the end of the images, it costs what it does at the nearest lags at which
    enough is: nothing is won by a lag that nothing tells."""
    order = np.argsort(moments.block, kind="stable")
    begins = np.searchsorted(moments.block[order], np.arange(moments.n_blocks))
    total, seen, number = (np.add.reduceat(each[order], begins, axis=0) for each in sums)
    most = seen.max(axis=1, keepdims=True)
    told = (seen >= _ENOUGH * most) & (number >= _MIN_SEEN)
    mean = total / np.where(told, seen, 1.0)
    return np.stack([_filled(*row) for row in zip(mean, told, strict=True)]) * most


def _filled(mean: Float[np.ndarray, " lag"], told: Bool[np.ndarray, " lag"]) -> Float[np.ndarray, " lag"]:
    lags = np.arange(len(mean))
    return np.interp(lags, lags[told], mean[told]) if told.any() else np.zeros(len(mean))


def _at(
    cost: Float[np.ndarray, "moment lag"], lag_s: Float[np.ndarray, " lag"], finer_s: Float[np.ndarray, " finer"]
) -> Float[np.ndarray, "moment finer"]:
    from scipy.interpolate import CubicSpline

    return CubicSpline(lag_s, cost, axis=1)(finer_s).astype(np.float32)
