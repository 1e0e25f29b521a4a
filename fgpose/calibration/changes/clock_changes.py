"""What the clock of a camera does: nothing, a constant offset, a jump or a rate; told by blocks that did not enter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from fgpose.calibration.changes.change import Kind
from fgpose.calibration.changes.lag_costs import PER_STEP, LagCosts, told_blocks

_NEGLIGIBLE_GAIN = 4.0
# Blocks on either side of a jump, and in which an offset must be better.
MIN_BLOCKS = 3


@dataclass(frozen=True, eq=False)
class ClockFit:
    """The lags that fit best, of one kind."""

    kind: Kind
    lag: Float[np.ndarray, " block"]
    """In steps of the costs."""
    first_after: int
    """Block with which a jump begins."""
    gain: Float[np.ndarray, " block"]
    """By how much the cost of each block is less, with lags to which it has not contributed."""


def clock_fits(costs: LagCosts, c: int) -> list[ClockFit]:
    """The best of each kind."""
    cost = costs.of_camera(c)
    told = told_blocks(costs, c)
    if told.sum() < 2 * MIN_BLOCKS:
        return []
    time = costs.blocks.time_s - costs.blocks.time_s[0]
    odd = np.cumsum(told) % 2 == 1
    centre = cost.shape[1] // 2
    found = []
    for kind in (Kind.OFFSET, Kind.JUMP, Kind.RATE):
        whole = _fit(kind, cost, told, time)
        gain = np.zeros(len(cost))
        for half in (odd, ~odd):
            lag, _ = _fit(kind, cost * half[:, None], told & half, time)
            rows = np.flatnonzero(told & ~half)
            gain[rows] = cost[rows, centre] - _at(cost[rows], lag[rows])
        found.append(ClockFit(kind, whole[0] - centre, whole[1], gain))
    return found


def _at(cost: Float[np.ndarray, "block lag"], lag: Float[np.ndarray, " block"]) -> Float[np.ndarray, " block"]:
    number = np.clip(np.round(lag).astype(int), 0, cost.shape[1] - 1)
    return cost[np.arange(len(cost)), number]


def _fit(
    kind: Kind, cost: Float[np.ndarray, "block lag"], told: Bool[np.ndarray, " block"], time: Float[np.ndarray, " block"]
) -> tuple[Float[np.ndarray, " block"], int]:
    """Of each block the index of its lag; and the block with which a jump begins."""
    if kind is Kind.OFFSET:
        return np.full(len(cost), _minimum(cost.sum(axis=0))), 0
    if kind is Kind.RATE:
        return _line(cost, time), 0
    before = np.cumsum(cost, axis=0)
    after = before[-1] - before
    number = np.cumsum(told)
    possible = (number >= MIN_BLOCKS) & (number[-1] - number >= MIN_BLOCKS)
    if not possible.any():
        return np.full(len(cost), _minimum(cost.sum(axis=0))), 0
    least = np.where(possible, before.min(axis=1) + after.min(axis=1), np.inf)
    last = int(np.argmin(least))
    lags = np.where(np.arange(len(cost)) <= last, _minimum(before[last]), _minimum(after[last]))
    return lags, last + 1


def _minimum(cost: Float[np.ndarray, " lag"]) -> float:
    """Of a parabola through the least and its neighbours."""
    best = int(np.argmin(cost))
    if not 0 < best < len(cost) - 1:
        return float(best)
    left, least, right = cost[best - 1 : best + 2]
    bend = left - 2 * least + right
    return best + (0.5 * (left - right) / bend if bend > 0 else 0.0)


def _line(cost: Float[np.ndarray, "block lag"], time: Float[np.ndarray, " block"]) -> Float[np.ndarray, " block"]:
    """Lags that grow evenly: by their values at the beginning and at the end, first by whole steps."""
    share = time / max(float(time[-1]), 1e-9)
    ends = np.arange(0, cost.shape[1], PER_STEP)
    used = np.flatnonzero(cost.any(axis=1))
    best, step = (cost.shape[1] // 2, cost.shape[1] // 2), PER_STEP
    first, last = np.meshgrid(ends, ends, indexing="ij")
    while True:
        total = np.zeros(first.shape)
        for block in used.tolist():
            lag = np.round(first + share[block] * (last - first)).astype(int)
            total += cost[block, np.clip(lag, 0, cost.shape[1] - 1)]
        where = np.unravel_index(int(np.argmin(total)), total.shape)
        best = (float(first[where]), float(last[where]))
        if step <= 0.5:
            return best[0] + share * (best[1] - best[0])
        step /= 2
        near = step * np.arange(-3, 4)
        first, last = np.meshgrid(best[0] + near, best[1] + near, indexing="ij")


def score(gain: Float[np.ndarray, " block"]) -> float:
    """By how much blocks that did not enter are better with a change, in standard deviations of what they would be by
    chance: by chance as many are worse as are better, and few are worse if the change is true."""
    worse = np.minimum(gain, 0.0)
    return float(gain.sum() / np.sqrt(2 * np.sum(worse**2) + _NEGLIGIBLE_GAIN**2))
