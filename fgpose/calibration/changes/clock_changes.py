"""What the clock of a camera does: nothing, a constant offset, a jump or a rate; told by blocks that did not enter."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float

from fgpose.calibration.changes.change import Kind
from fgpose.calibration.changes.lag_costs import PER_STEP, LagCosts, edges_as_good, told_blocks

_NEGLIGIBLE_GAIN = 4.0
# In the same units: a simpler change is as good.
_AS_GOOD = 10.0
_USUAL = 0.75  # a quantile: more blocks than that are right
_NTSC = 0.001  # 30 Hz are 29.97
# Blocks on either side of a jump, and in which an offset must be better.
MIN_BLOCKS = 3
_OF_HALF = 2  # of them, when only every other block is used


@dataclass(frozen=True, eq=False)
class ClockFit:
    """The lags that fit best, of one kind."""

    kind: Kind
    lag: Float[np.ndarray, " block"]
    """In steps of the costs."""
    free_lag: Float[np.ndarray, " block"]
    """The same before simple numbers took its place."""
    firsts: tuple[int, ...]
    """Blocks with which jumps begin."""
    gain: Float[np.ndarray, " block"]
    """By how much the cost of each block is less, with lags to which it has not contributed."""
    by_chance: float
    """By how much the cost of all blocks differs by chance: each costs less at the lag that suits it best, by about one
    where errors of detections are as usual."""
    edges: tuple[tuple[int, int], ...]
    """The first and the last block with which each jump may begin."""
    sigma: float
    """Standard deviation of the free lag, of the jump that is known least, or of what the rate adds up to, in steps of
    the costs; from the scatter of the blocks."""

    def change_sigma(self, change: float, free_change: float) -> float:
        """Standard deviation of a simple number that stands for one that was measured: it has to hold both. Cameras
        lose whole images, and one that connects again is late by any number of them."""
        return float(np.hypot(self.sigma, change - free_change))


def clock_fits(costs: LagCosts, c: int, step_s: float) -> list[ClockFit]:
    """The best of each kind; with the simple numbers that recordings usually have, if they are as good.

    Args:
        step_s: of the images.
    """
    cost = costs.of_camera(c)
    told = told_blocks(costs, c)
    if told.sum() < 2 * MIN_BLOCKS:
        return []
    time = costs.blocks.time_s - costs.blocks.time_s[0]
    odd = np.cumsum(told) % 2 == 1
    centre = cost.shape[1] // 2
    found = []
    for kind, n_jumps in ((Kind.OFFSET, 0), (Kind.JUMP, 1), (Kind.JUMP, 2), (Kind.RATE, 0)):
        lag, firsts = _fit(kind, cost, told, time, n_jumps, MIN_BLOCKS)
        if len(firsts) < n_jumps:
            continue
        gain = np.zeros(len(cost))
        for half in (odd, ~odd):
            of_half, own_firsts = _fit(kind, cost * half[:, None], told & half, time, n_jumps, _OF_HALF)
            rows = np.flatnonzero(told & ~half)
            gain[rows] = (cost[:, centre] - _least(cost, of_half, own_firsts, told & half))[rows]
        free_lag = lag - centre
        lag = _simple(kind, free_lag, firsts, cost, costs, step_s)
        edges, sigma = _edges(cost, lag + centre, firsts), _sigma(kind, free_lag + centre, firsts, cost, time)
        found.append(ClockFit(kind, lag, free_lag, firsts, gain, _by_chance(cost, lag + centre, told), edges, sigma))
    return found


def constant_lag(costs: LagCosts, c: int) -> tuple[float, float]:
    """That which fits best, and its standard deviation, in steps of the costs: with that of the best line from it, for
    clocks may drift by less than is noticed."""
    cost, time = costs.of_camera(c), costs.blocks.time_s
    lag = float(_minimum(cost.sum(axis=0)))
    drift = float(np.std(_line(cost, time - time[0])))
    sigma = float(np.hypot(_sigma(Kind.OFFSET, np.full(len(cost), lag), (), cost, time), drift))
    return lag - cost.shape[1] // 2, sigma


def _by_chance(
    cost: Float[np.ndarray, "block lag"], lag: Float[np.ndarray, " block"], told: Bool[np.ndarray, " block"]
) -> float:
    """Of blocks that are independent; without those that suit none, as where a view shows somebody else."""
    left = (_at(cost, lag) - cost.min(axis=1))[told]
    return float(np.sqrt(len(left)) * np.quantile(left, _USUAL))


def _least(
    cost: Float[np.ndarray, "block lag"],
    lag: Float[np.ndarray, " block"],
    firsts: tuple[int, ...],
    told: Bool[np.ndarray, " block"],
) -> Float[np.ndarray, " block"]:
    """Of each block at its lag; where these do not tell whether a jump is before or after it, at the better one."""
    least = _at(cost, lag)
    for first in firsts:
        before, after = np.flatnonzero(told[:first])[-1], first + np.flatnonzero(told[first:])[0]
        for either in (before, after):
            other = _at(cost, np.full(len(cost), lag[either]))
            least[before + 1 : after] = np.minimum(least, other)[before + 1 : after]
    return least


def _simple(
    kind: Kind,
    lag: Float[np.ndarray, " block"],
    firsts: tuple[int, ...],
    cost: Float[np.ndarray, "block lag"],
    costs: LagCosts,
    step_s: float,
) -> Float[np.ndarray, " block"]:
    """Images that are lost are whole ones, cameras that were started together began together, and 29.97 Hz is what is
    taken for 30: lags of that kind, if they are as good as the best."""
    centre, frame = cost.shape[1] // 2, step_s / costs.step_s
    simpler: list[Float[np.ndarray, " block"]] = []
    if kind is Kind.JUMP:
        by = np.zeros(len(lag))
        for first in firsts:
            by[first:] += frame * round((lag[first] - lag[first - 1]) / frame)
        simpler = [by, lag[0] + by]
    elif kind is Kind.RATE:
        time_s = costs.blocks.time_s
        slope = np.sign(lag[-1] - lag[0]) * _NTSC / (costs.step_s * (1 + np.sign(lag[-1] - lag[0]) * _NTSC))
        own = np.sum(lag * time_s) / np.sum(time_s**2)
        simpler = [slope * time_s, own * time_s, np.mean(lag - slope * time_s) + slope * time_s]
        simpler += [share * own * time_s for share in (0.95, 0.975, 1.025, 1.05)]
    best = _at(cost, lag + centre).sum()
    for each in simpler:
        if _at(cost, each + centre).sum() < best + _AS_GOOD:
            return each
    return lag


def _edges(
    cost: Float[np.ndarray, "block lag"], lag: Float[np.ndarray, " block"], firsts: tuple[int, ...]
) -> tuple[tuple[int, int], ...]:
    found = []
    for before, first, after in zip((0, *firsts), firsts, (*firsts[1:], len(lag)), strict=False):
        part = cost[before:after]
        costs = [_at(part, np.full(len(part), lag[either])) for either in (first - 1, first)]
        begin, end = edges_as_good(*costs)
        found.append((before + begin, before + end))
    return tuple(found)


def _sigma(
    kind: Kind,
    lag: Float[np.ndarray, " block"],
    firsts: tuple[int, ...],
    cost: Float[np.ndarray, "block lag"],
    time: Float[np.ndarray, " block"],
) -> float:
    apart = PER_STEP // 2
    right, here, left = _at(cost, lag + apart), _at(cost, lag), _at(cost, lag - apart)
    slope, bend = (right - left) / (2 * apart), np.maximum(right - 2 * here + left, 0.0) / apart**2
    share = (time - time.mean()) / max(float(np.ptp(time)), 1e-9) if kind is Kind.RATE else np.ones(len(time))
    parts = [slice(first, end) for first, end in zip((0, *firsts), (*firsts, len(time)), strict=True)]
    variances = [_variance(slope[part], bend[part], share[part]) for part in parts]
    most = max(a + b for a, b in pairwise(variances)) if firsts else variances[0]
    return float(np.sqrt(most))


def _variance(
    slope: Float[np.ndarray, " block"], bend: Float[np.ndarray, " block"], share: Float[np.ndarray, " block"]
) -> float:
    """Of one number that the lags of some blocks have in common, each by its share; in squared steps of the costs."""
    tells = bend * share**2 > 0
    freedom = max(int(tells.sum()) - 1, 1)
    scatter = np.sum((slope * share) ** 2) / max(np.sum(bend * share**2), 1e-9) ** 2
    # Few blocks scatter less around what suits them best than around the truth, and leave open by how much.
    scatter *= (freedom + 1) / max(freedom - 2, 1)
    # Where errors are small, costs bend within less than the step of the images, and are least at a step of the costs.
    return float(scatter) + 1 / 12


def _at(cost: Float[np.ndarray, "block lag"], lag: Float[np.ndarray, " block"]) -> Float[np.ndarray, " block"]:
    number = np.clip(np.round(lag).astype(int), 0, cost.shape[1] - 1)
    return cost[np.arange(len(cost)), number]


def _fit(
    kind: Kind,
    cost: Float[np.ndarray, "block lag"],
    told: Bool[np.ndarray, " block"],
    time: Float[np.ndarray, " block"],
    n_jumps: int,
    least_told: int,
) -> tuple[Float[np.ndarray, " block"], tuple[int, ...]]:
    """Of each block the index of its lag; and the blocks with which jumps begin."""
    if kind is Kind.RATE:
        return _line(cost, time), ()
    firsts = _jumps(cost, told, n_jumps, least_told)
    lag = np.empty(len(cost))
    for first, end in zip((0, *firsts), (*firsts, len(cost)), strict=True):
        lag[first:end] = _minimum(cost[first:end].sum(axis=0))
    return lag, firsts


def _jumps(
    cost: Float[np.ndarray, "block lag"], told: Bool[np.ndarray, " block"], n_jumps: int, least_told: int
) -> tuple[int, ...]:
    """The blocks with which the lags of the least cost begin, by dynamic programming; fewer where there is no room."""
    before = np.concatenate([np.zeros((1, cost.shape[1])), np.cumsum(cost, axis=0)])[:, :: PER_STEP // 2]
    number = np.concatenate([[0], np.cumsum(told)])
    n = len(before)
    least = np.full((n, n), np.inf)
    for first in range(n - 1):
        own = (before[first + 1 :] - before[first]).min(axis=1)
        least[first, first + 1 :] = np.where(number[first + 1 :] - number[first] >= least_told, own, np.inf)
    best, cut = least[0], []
    for _ in range(n_jumps):
        through = best[:, None] + least
        cut.append(np.argmin(through, axis=0))
        best = through.min(axis=0)
    if not np.isfinite(best[-1]):
        return ()
    firsts, end = [], n - 1
    for of_end in reversed(cut):
        end = int(of_end[end])
        firsts.append(end)
    return tuple(reversed(firsts))


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
