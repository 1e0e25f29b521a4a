"""How late each camera is from moment to moment, if its clock jumps forward by whole images whenever some are lost.

The clock of a camera is a path: it stays where it is, or rises by a number of images. How often it rises, and by how
much, is learned from the recording. Beside the others, the most probable path of a camera is found by dynamic
programming; all of them, one camera after the other until all stay.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.calibration.changes.lost_images.fine_costs import PER_IMAGE, FineCosts

# Logarithm of how improbable images are lost at a moment, until it is known that they are: once in four hours.
_STRICT = 12.0
_ROUNDS, _LEARNED = 10, 6
_STARTS = 4  # pairs of cameras with which the paths are begun
_EDGE_S = 1.0  # at the beginning and the end of a recording, in which no jump is looked for
_LEAST_MEAN = 1.2  # images that are lost at once, for a mean that has a spread


class Price(NamedTuple):
    """What a jump costs: minus the logarithm of how probable it is."""

    first: float
    """By one image."""
    more: float
    """Each image more."""

    @staticmethod
    def strict() -> Price:
        return Price(_STRICT, 0.0)

    @staticmethod
    def learned(frames: Int[np.ndarray, " jump"], n_moments: int, usual: float) -> Price:
        """Of a camera that lost images at some of these moments; how many at once is learned from all cameras.

        Args:
            frames: of each jump.
            usual: number of images that are lost at once.
        """
        if not len(frames):
            return Price.strict()
        share = (len(frames) + 0.5) / (n_moments + 1)
        ends = 1 / max(usual, _LEAST_MEAN)
        return Price(float(np.log((1 - share) / share) - np.log(ends)), float(-np.log(1 - ends)))

    def of(self, frames: Int[np.ndarray, " jump"]) -> float:
        return float(np.sum(self.first + self.more * (frames - 1)))


class Paths(NamedTuple):
    """The clocks of all cameras."""

    lag: Int[np.ndarray, "camera moment"]
    """How late each is, in steps of the costs, by the common clock."""
    prices: tuple[Price, ...]

    def jumps(self, c: int) -> list[tuple[int, int]]:
        """The moments with which jumps of a camera begin, and by how many images."""
        by = np.diff(self.lag[c]) // PER_IMAGE
        return [(int(k) + 1, int(by[k])) for k in np.flatnonzero(by)]

    @property
    def price(self) -> float:
        return _price(self.prices, self.lag)

    @property
    def n_jumps(self) -> int:
        return int((np.diff(self.lag, axis=1) > 0).sum())


def jumps_beside(costs: FineCosts, lag: Int[np.ndarray, "camera moment"]) -> bool:
    """Whether any clock jumps beside others that are late by so much: a quick look."""
    everybody = range(costs.n_cameras)
    beside = (_beside(costs, Price.strict(), c, lag, [o for o in everybody if o != c]) for c in everybody)
    return any(bool(np.ptp(own)) for own in beside)


def clock_paths(costs: FineCosts) -> Paths:
    """The most probable paths; how often images are lost is at first taken for hardly ever, and then as found."""
    prices = (Price.strict(),) * costs.n_cameras
    lag = _together(costs, prices)
    for _ in range(_LEARNED):
        by = np.diff(lag, axis=1) // PER_IMAGE
        if not by.any():
            break
        usual = float(by[by > 0].mean())
        prices = tuple(Price.learned(own[own > 0], len(own), usual) for own in by)
        former, lag = lag, _settled(costs, prices, lag)
        if np.array_equal(former, lag):
            break
    return Paths(lag, prices)


def _together(costs: FineCosts, prices: tuple[Price, ...]) -> Int[np.ndarray, "camera moment"]:
    """Begun with two cameras, to which the others are added one by one; of some pairs the one that ends best."""
    tells = {pair: float((cost.mean(axis=1) - cost.min(axis=1)).sum()) for pair, cost in costs.cost.items()}
    found, least = None, np.inf
    for pair in sorted(tells, key=lambda pair: -tells[pair])[:_STARTS]:
        lag = _settled(costs, prices, _begun(costs, prices, pair, tells))
        total = float(costs.total(lag).sum()) + _price(prices, lag)
        if found is None or total < least - 1e-6:
            found, least = lag, total
    assert found is not None
    return found


def _begun(
    costs: FineCosts, prices: tuple[Price, ...], pair: tuple[int, int], tells: dict[tuple[int, int], float]
) -> Int[np.ndarray, "camera moment"]:
    a, b = pair
    lag = np.zeros((costs.n_cameras, costs.moments.n_blocks), dtype=int)
    # Of two cameras only the difference is seen: where it falls, the first one lost images.
    between = _path(costs.cost[pair], prices[b], _inner(costs), both=True) - costs.n_lags // 2
    rise = np.diff(between, prepend=between[0])
    lag[a], lag[b] = np.cumsum(np.maximum(-rise, 0)), between[0] + np.cumsum(np.maximum(rise, 0))
    placed = [a, b]
    while left := [c for c in range(costs.n_cameras) if c not in placed]:
        c = max(left, key=lambda c: sum(tells[min(c, o), max(c, o)] for o in placed))
        lag[c] = _beside(costs, prices[c], c, lag, placed)
        placed.append(c)
    return lag


def _settled(
    costs: FineCosts, prices: tuple[Price, ...], lag: Int[np.ndarray, "camera moment"]
) -> Int[np.ndarray, "camera moment"]:
    """Each beside all others, until all stay."""
    lag, everybody = lag.copy(), range(costs.n_cameras)
    for _ in range(_ROUNDS):
        former = lag.copy()
        for c in everybody:
            lag[c] = _beside(costs, prices[c], c, lag, [o for o in everybody if o != c])
        lag -= _common(lag[:, 0])
        if np.array_equal(former, lag):
            break
    return lag


def _common(starts: Int[np.ndarray, " camera"]) -> int:
    """What is common to all is nothing: as many cameras as possible began on time."""
    return max(starts.tolist(), key=lambda lag: (int((np.abs(starts - lag) <= 1).sum()), -abs(lag)))


def _beside(
    costs: FineCosts, price: Price, c: int, lag: Int[np.ndarray, "camera moment"], others: list[int]
) -> Int[np.ndarray, " moment"]:
    return _path(costs.of_camera(c, lag, others), price, _inner(costs)) - costs.n_lags // 2


def _price(prices: tuple[Price, ...], lag: Int[np.ndarray, "camera moment"]) -> float:
    total = 0.0
    for price, own in zip(prices, np.diff(lag, axis=1) // PER_IMAGE, strict=True):
        total += price.of(own[own > 0]) if own.any() else 0.0
    return total


def _inner(costs: FineCosts) -> Bool[np.ndarray, " moment"]:
    """Moments with which a jump may begin."""
    time_s = costs.moments.time_s
    return (time_s - time_s[0] >= _EDGE_S) & (time_s[-1] - time_s >= _EDGE_S)


def _path(
    cost: Float[np.ndarray, "moment lag"], price: Price, inner: Bool[np.ndarray, " moment"], *, both: bool = False
) -> Int[np.ndarray, " moment"]:
    """The path of the least cost, as indices of its lags.

    Args:
        both: whether it may fall as well.
    """
    n_moments, n_lags = cost.shape
    least, numbers = cost[0].astype(float), np.arange(n_lags)
    came = np.zeros((n_moments, n_lags), dtype=int)
    for k in range(1, n_moments):
        came[k] = numbers
        if inner[k] and np.isfinite(price.first):
            risen = [_risen(least, price)]
            if both:
                fallen, before = _risen(least[::-1], price)
                risen.append((fallen[::-1], (n_lags - 1 - before)[::-1]))
            for total, before in risen:
                came[k] = np.where(total < least, before, came[k])
                least = np.minimum(total, least)
        least = least + cost[k]
    path = np.empty(n_moments, dtype=int)
    path[-1] = int(np.argmin(least))
    for k in range(n_moments - 1, 0, -1):
        path[k - 1] = came[k, path[k]]
    return path


def _risen(least: Float[np.ndarray, " lag"], price: Price) -> tuple[Float[np.ndarray, " lag"], Int[np.ndarray, " lag"]]:
    """The least cost with which each lag is reached from a smaller one, by one image or more; and from which."""
    n_images = -(-len(least) // PER_IMAGE)
    padded = np.full(n_images * PER_IMAGE, np.inf)
    padded[: len(least)] = least
    image = np.arange(n_images)[:, None]
    by_image = padded.reshape(n_images, PER_IMAGE) - price.more * image
    running = np.minimum.accumulate(by_image, axis=0)
    origin = np.maximum.accumulate(np.where(by_image == running, image, 0), axis=0)
    total, before = np.full_like(running, np.inf), np.zeros(running.shape, dtype=int)
    total[1:] = running[:-1] + price.more * (image[1:] - 1) + price.first
    before[1:] = origin[:-1] * PER_IMAGE + np.arange(PER_IMAGE)
    return total.ravel()[: len(least)], before.ravel()[: len(least)]
