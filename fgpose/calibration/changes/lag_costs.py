"""How badly the cameras agree in each block of time, for every lag of one behind another.

Of two cameras that are where the rig says, the rays to a joint meet if both images were taken at the same time: the
angle by which they miss each other is what a lag, or another pose, makes larger. No motion needs to be estimated, and
two cameras are enough.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.calibration.changes.motion_share import displacements, motion_share
from fgpose.calibration.changes.rays import Rays
from fgpose.estimation.noise import CORRELATION_S
from fgpose.freed_memory import hand_back
from fgpose.geometry.vectors import cross, dot
from fgpose.sampling import parts_of
from fgpose_factors.robust_statistics import robust_sigma

BLOCK_S = 1.0
"""Errors of detections are correlated over 0.15 s: blocks of a second are independent of each other."""
_MAX_BLOCKS = 300
# Of rays of two cameras that are compared at one lag: bounds the time.
_MAX_COMPARED = 3e5
_SAMPLE_HZ = 10.0  # not much more than errors of detections are independent
# A lag is known to a fraction of a step: costs are interpolated.
PER_STEP = 4
KERNEL = 2.0
"""Scale of the Cauchy kernel, in standard deviations of the angles between rays that meet."""
LEAST_GAIN = 20.0
"""In-sample, below which the blocks that did not enter need not be asked."""
# Of the directions in which cameras see people, and of the people, root mean square.
_WALKS_RAD, _WALKS_M = 0.08, 0.3
# Logarithm of how much less probable another second may be, if a camera may still have changed then. At 10 the seconds
# that are left contain the true one in 64 of 64 recordings by two and three cameras, also of somebody who works on the
# spot and pauses for seconds; at 5 in 63.
_AS_PROBABLE = 10.0
AT_ONCE = 500
"""Samples of which costs and weights are made at a time."""
# A camera's pairs of rays say something of a block if there are so many.
_MIN_SEEN = 8
# Of rays that meet angles are 2 to 3 times what they differ from their mean in a second: errors last longer. Where the
# calibration is wrong they are wider, and not because joints move.
_PER_FLUCTUATION = 3.0
_MOSTLY = 0.5  # of what moves in images is the body


@dataclass(frozen=True, eq=False)
class Blocks:
    """The times at which rays are compared, second by second."""

    index: Int[np.ndarray, " sample"]
    """In the grid of the rays."""
    block: Int[np.ndarray, " sample"]
    time_s: Float[np.ndarray, " block"]
    """In the middle, increasing."""
    length_s: float

    @property
    def n_blocks(self) -> int:
        return len(self.time_s)

    def only(self, held: Bool[np.ndarray, " block"]) -> Blocks:
        """The samples of some blocks."""
        own = held[self.block]
        return Blocks(self.index[own], self.block[own], self.time_s, self.length_s)


def blocks_of(rays: Rays, n_joints: int) -> Blocks:
    """Of rays, so many blocks and samples as are needed."""
    there = np.flatnonzero(np.isfinite(rays.time_s))
    begin_s, end_s = rays.time_s[there].min(), rays.time_s[there].max()
    length_s = max(BLOCK_S, (end_s - begin_s) / _MAX_BLOCKS)
    n_pairs = rays.n_cameras * (rays.n_cameras - 1) / 2
    duration_s = len(there) * rays.step_s
    most = max(min(int(_MAX_COMPARED / (n_pairs * n_joints)), int(_SAMPLE_HZ * duration_s)), 1)
    # Not an even stride: it could be in step with a gait.
    index = there if len(there) <= most else there[np.unique((np.arange(most) + 0.5) * len(there) / most).astype(int)]
    numbers, block = np.unique(((rays.time_s[index] - begin_s) / length_s).astype(int), return_inverse=True)
    return Blocks(index, block, begin_s + (numbers + 0.5) * length_s, length_s)


@dataclass(frozen=True, eq=False)
class LagCosts:
    """Of each pair of cameras: minus the logarithm of how probable its angles are, block by block, as far as joints
    move: of who stands still every lag is as probable."""

    blocks: Blocks
    step_s: float
    """Of the lags."""
    pairs: tuple[tuple[int, int], ...]
    cost: dict[tuple[int, int], Float[np.ndarray, "block lag"]]
    """By how much later the second took its images, relative to the first. The lags are even and symmetric."""
    scale: dict[tuple[int, int], float]
    """Standard deviation of the angles, radians."""
    moves: Bool[np.ndarray, " block"]
    """Whether joints move, by more than their detections err."""

    @property
    def lag_s(self) -> Float[np.ndarray, " lag"]:
        n = next(iter(self.cost.values())).shape[1]
        return self.step_s * (np.arange(n) - n // 2)

    def of_camera(self, c: int) -> Float[np.ndarray, "block lag"]:
        """Of all pairs of a camera, by how much later it is, while the others are on time."""
        own = [self.cost[pair] if pair[1] == c else self.cost[pair][:, ::-1] for pair in self.pairs if c in pair]
        return np.sum(own, axis=0)


def edges_as_good(cost_before: Float[np.ndarray, " block"], cost_after: Float[np.ndarray, " block"]) -> tuple[int, int]:
    """The first and the last block with which a change may begin, nearly as probably as with the best; blocks before it
    cost the one, and from it on the other. Where nobody moves they do not tell."""
    total = np.concatenate([[0.0], np.cumsum(cost_before - cost_after)])
    near = np.flatnonzero(total < total.min() + _AS_PROBABLE)
    return int(near[0]), int(near[-1])


def angle(
    one: Float[np.ndarray, "*#shape 3"],
    other: Float[np.ndarray, "*#shape 3"],
    baseline_m: Float[np.ndarray, "*#shape 3"],
) -> Float[np.ndarray, "*angles"]:
    """By how much two rays miss each other, signed, in standard deviations if both directions err by one."""
    from_one, from_other = cross(baseline_m, one), cross(baseline_m, other)
    length = np.sqrt(dot(from_one, from_one) + dot(from_other, from_other))
    return dot(from_one, other) / np.where(length > 0, length, np.nan)


def reach_m(
    own: Float[np.ndarray, "sample joint 3"],
    others: Float[np.ndarray, "other sample joint 3"],
    baseline_m: Float[np.ndarray, "other sample 1 3"],
) -> Float[np.ndarray, " other"]:
    """Of each other camera the median of the root of the summed squares of both distances to where the rays are
    nearest: both directions err."""
    cosine = dot(own, others)
    along_own, along_other = dot(own, baseline_m), dot(others, baseline_m)
    with np.errstate(invalid="ignore", divide="ignore"):
        depth_m = (along_own - cosine * along_other) / (1 - cosine**2)
        other_depth_m = (cosine * along_own - along_other) / (1 - cosine**2)
    meet = (depth_m > 0) & (other_depth_m > 0)
    length_m = np.hypot(depth_m, other_depth_m)
    return np.array([np.median(each[of]) if of.any() else np.nan for each, of in zip(length_m, meet, strict=True)])


def somebody_walks(rays: Rays, blocks: Blocks) -> bool:
    """Whether cameras see people in different places, and so from different sides. Of somebody who stands still, errors
    that a network makes in each view look like another place or another lens of a camera."""
    direction, centre_m = rays.direction[:, blocks.index], rays.centre_m[:, blocks.index]
    spreads = []
    for c, own in enumerate(direction):
        seen = own[np.isfinite(own).all(axis=(1, 2))].mean(axis=1)
        if len(seen):
            spread = float(np.sqrt(np.mean(np.sum((seen - seen.mean(axis=0)) ** 2, axis=-1))))
            others = np.delete(np.arange(rays.n_cameras), c)
            far_m = reach_m(own, direction[others], (centre_m[others] - centre_m[c])[:, :, None]) / np.sqrt(2)
            spreads.append((spread, spread * float(np.nanmedian(far_m)) if np.isfinite(far_m).any() else 0.0))
    return bool(spreads) and bool((np.median(spreads, axis=0) > (_WALKS_RAD, _WALKS_M)).all())


def robust(
    angle: Float[np.ndarray, "*shape"], scale: float, out: Float[np.ndarray, "*shape"] | None = None
) -> Float[np.ndarray, "*shape"]:
    """Half of Cauchy's kernel, whitened; in the place of an array that nobody needs any more, if one is given."""
    cost = np.divide(angle, KERNEL * scale, out=out)
    np.log1p(np.square(cost, out=cost), out=cost)
    return np.multiply(0.5 * KERNEL**2, cost, out=cost)


def weighted(
    angle: Float[np.ndarray, "*shape"], weight: Float[np.ndarray, "*shape"], scale: float = 1.0
) -> Float[np.ndarray, "*shape"]:
    """The same of rays that count so much; 0 of those that are not seen, or do not tell an angle."""
    return np.where(weight > 0, weight * np.nan_to_num(robust(angle, scale)), 0.0)


def reweighted(
    angle: Float[np.ndarray, "*shape"], weight: Float[np.ndarray, "*shape"], width: float
) -> Float[np.ndarray, "*shape"]:
    """What whitened angles count in least squares; the kernel is wider by this factor."""
    known = (weight > 0) & np.isfinite(angle)
    return np.where(known, weight / (1 + (np.nan_to_num(angle) / (width * KERNEL)) ** 2), 0.0)


def wide_enough(angle: Float[np.ndarray, "*shape"], weight: Float[np.ndarray, "*shape"]) -> float:
    """Width of the kernel with which the larger ones of whitened angles count, in which another pose or lens shows."""
    known = np.abs(angle[(weight > 0) & np.isfinite(angle)])
    return max(1.0, float(np.quantile(known, 0.8))) if known.size else 1.0


def independent(blocks: Blocks) -> float:
    """By how much the samples of a block count, as their errors are correlated."""
    per_block = len(blocks.index) / blocks.n_blocks
    return min(1.0, blocks.length_s / CORRELATION_S / per_block)


def lag_costs(rays: Rays, blocks: Blocks, n_lags: int, of_camera: int | None = None) -> LagCosts:
    """Costs for lags of up to so many steps of the grid either way; of all pairs, or of those of one camera."""
    pairs = tuple(pair for pair in combinations(range(rays.n_cameras), 2) if of_camera is None or of_camera in pair)
    moved = displacements(rays, blocks.index)
    cost, scale, most = {}, {}, []
    for pair in pairs:
        cost[pair], scale[pair], share = _of_pair(rays, blocks, *pair, n_lags, moved[list(pair)])
        most.append(share.max(axis=1))
        hand_back()
    return LagCosts(blocks, rays.step_s / PER_STEP, pairs, cost, scale, np.median(most, axis=0) > _MOSTLY)


def _of_pair(
    rays: Rays, blocks: Blocks, a: int, b: int, n_lags: int, moved: Float[np.ndarray, "2 sample joint 3"]
) -> tuple[Float[np.ndarray, "block lag"], float, Float[np.ndarray, "block joint"]]:
    samples = SampleCosts.of(rays, blocks, (a, b), n_lags, moved)
    return _finer(_by_block(samples, blocks) * independent(blocks)), samples.scale, samples.share


@dataclass(frozen=True, eq=False)
class SampleCosts:
    """Of two cameras: what the angle of each sample costs at every lag. Of an hour the angles take 20 MB, and whatever
    else there is of each is made of some samples at a time."""

    rays: Rays
    blocks: Blocks
    pair: tuple[int, int]
    angles: Float[np.ndarray, "sample lag joint"]
    scale: float
    """Standard deviation of the angles, radians."""
    share: Float[np.ndarray, "block joint"]
    """How far each joint moves."""

    @staticmethod
    def of(
        rays: Rays, blocks: Blocks, pair: tuple[int, int], n_lags: int, moved: Float[np.ndarray, "2 sample joint 3"]
    ) -> SampleCosts:
        """For lags of up to so many steps of the grid either way, from the displacements of both."""
        a, b = pair
        angles = _angles(rays, blocks, a, b, n_lags)
        scale = _scale(angles, blocks)
        by_errors = min(scale, _PER_FLUCTUATION * _scale(angles, blocks, about_mean=True))
        baseline_m = (rays.centre_m[b, blocks.index] - rays.centre_m[a, blocks.index])[:, None]
        n_reach = int(np.ceil(n_lags * rays.step_s / blocks.length_s))
        share = motion_share(moved, rays.direction[a, blocks.index], baseline_m, blocks.block, n_reach, by_errors)
        return SampleCosts(rays, blocks, pair, angles, scale, share)

    @property
    def n_lags(self) -> int:
        return self.angles.shape[1]

    def weighted(
        self, part: slice
    ) -> tuple[Float[np.ndarray, "sample lag joint"], Float[np.ndarray, "sample lag joint"]]:
        """Of some samples: what each costs times how much it counts as far as the joint moves, and that."""
        (a, b), index, angles = self.pair, self.blocks.index[part], self.angles[part]
        weight = np.zeros(angles.shape, dtype=np.float32)
        for k in range(self.n_lags):
            other = index - k + self.n_lags // 2
            there = (other >= 0) & (other < len(self.rays.time_s))
            weight[there, k] = np.minimum(self.rays.weight[a, index[there]], self.rays.weight[b, other[there]])
        weight[~np.isfinite(angles)] = 0.0
        weight *= self.share[self.blocks.block[part]][:, None]
        counted = np.nan_to_num(robust(angles, self.scale), copy=False)
        counted *= weight
        return counted, weight


def _angles(rays: Rays, blocks: Blocks, a: int, b: int, n_lags: int) -> Float[np.ndarray, "sample lag joint"]:
    index, n_times = blocks.index, len(rays.time_s)
    one = rays.direction[a, index]
    baseline_m = (rays.centre_m[b, index] - rays.centre_m[a, index])[:, None].astype(np.float32)
    from_one = cross(baseline_m, one)
    squared = dot(from_one, from_one)
    angles = np.full((len(index), 2 * n_lags + 1, one.shape[1]), np.nan, dtype=np.float32)
    along = dot(baseline_m, baseline_m)
    for k in range(-n_lags, n_lags + 1):
        other = index - k
        there = (other >= 0) & (other < n_times)
        ray = rays.direction[b, other[there]]
        of_other = along[there] - dot(baseline_m[there], ray) ** 2
        length = np.sqrt(squared[there] + np.maximum(of_other, 0.0))
        with np.errstate(invalid="ignore", divide="ignore"):
            angles[there, k + n_lags] = dot(from_one[there], ray) / length
    return angles


def _scale(angles: Float[np.ndarray, "sample lag joint"], blocks: Blocks, *, about_mean: bool = False) -> float:
    """Of angles between rays that meet: in most blocks they do at some lag, whatever the clocks are.

    Args:
        about_mean: of what they differ from their mean in a block: where the calibration is wrong, they do not meet.
    """
    least = []
    for block in range(blocks.n_blocks):
        own = angles[blocks.block == block][:, ::2]
        if about_mean:
            known = np.isfinite(own)
            own = own - np.nansum(own, axis=0) / np.maximum(known.sum(axis=0), 1)
        own = np.sort(np.abs(own).swapaxes(0, 1).reshape(own.shape[1], -1), axis=1)  # NaN last
        known = np.isfinite(own).sum(axis=1)
        if known.max(initial=0) >= _MIN_SEEN:
            middle = np.take_along_axis(own, np.maximum(known - 1, 0)[:, None] // 2, axis=1)[:, 0]
            least.append(middle[known >= 0.5 * known.max()].min())
    return max(robust_sigma(np.array(least)), 1e-4) if least else 1.0


def _by_block(samples: SampleCosts, blocks: Blocks) -> Float[np.ndarray, "block lag"]:
    """Sums, as if at every lag as much were seen as at the one where most is; a lag at which little is seen is as good
    as the others on average. What counts is what is seen without a lag too: where images are left out, the few that are
    near each other at one lag may be of another moment, which is easier to see."""
    order = np.argsort(blocks.block, kind="stable")
    begins = np.searchsorted(blocks.block[order], np.arange(blocks.n_blocks))
    middle = samples.n_lags // 2
    sums = np.empty((4, len(order), samples.n_lags))
    for part in parts_of(len(order), AT_ONCE):
        counted, weight = samples.weighted(part)
        both = np.where(weight[:, middle : middle + 1] > 0, weight, 0.0)
        for of_samples, each in zip(sums, (counted, weight, weight > 0, both), strict=True):
            of_samples[part] = each.sum(axis=2, dtype=float)
    total, seen, number, common = (np.add.reduceat(each[order], begins, axis=0) for each in sums)
    most = seen.max(axis=1, keepdims=True)
    told = (common >= 0.5 * most) & (number >= _MIN_SEEN)
    mean = np.where(told, total / np.where(told, seen, 1.0), np.nan)
    usual = np.where(told.any(axis=1), np.nansum(mean, axis=1) / np.maximum(told.sum(axis=1), 1), 0.0)
    return np.where(told, mean, usual[:, None]) * most


def _finer(cost: Float[np.ndarray, "block lag"]) -> Float[np.ndarray, "block finer"]:
    from scipy.interpolate import CubicSpline

    lags = np.arange(cost.shape[1])
    return CubicSpline(lags, cost, axis=1)(np.linspace(0, lags[-1], PER_STEP * lags[-1] + 1))


def told_blocks(costs: LagCosts, c: int) -> Bool[np.ndarray, " block"]:
    """Blocks in which the lag of a camera makes a difference."""
    return np.asarray(np.ptp(costs.of_camera(c), axis=1) > 1.0)
