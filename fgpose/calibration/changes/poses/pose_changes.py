"""Where a camera went: all the time, from a moment on, until one or between two; told by blocks that did not enter."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import gtsam
import numpy as np
from jaxtyping import Bool, Float

from fgpose.calibration.changes.change import Kind
from fgpose.calibration.changes.clock_changes import MIN_BLOCKS
from fgpose.calibration.changes.lag_costs import (
    LEAST_GAIN,
    Blocks,
    LagCosts,
    angle,
    edges_as_good,
    independent,
    reach_m,
    reweighted,
    weighted,
    wide_enough,
)
from fgpose.calibration.changes.poses.move_errors import Linearised, MoveErrors, move_errors
from fgpose.calibration.changes.poses.stretches import Stretch, best_stretch, better_stretch, stretches
from fgpose.calibration.changes.rays import Rays
from fgpose.config import CalibrationConfig
from fgpose.geometry.vectors import cross, dot

# Weak: what is bumped turns by degrees and moves by centimetres.
_SIGMAS = np.repeat([np.deg2rad(2.0), 0.05], 3)
_ROUNDS = 5
_LIMB, _FEWEST_JOINTS = 2, 6


@dataclass(frozen=True, eq=False)
class PoseFit:
    """The move that fits best."""

    kind: Kind
    rotation: Float[np.ndarray, " 3"]
    """Rotation vector in the world, radians."""
    translation_m: Float[np.ndarray, " 3"]
    held: Bool[np.ndarray, " block"]
    """The blocks in which the camera was there."""
    gain: Float[np.ndarray, " block"]
    """By how much the cost of each block is less, with a move to which it has not contributed."""
    edges: tuple[int, int]
    """The first and the last block with which a bump may begin, or end if it was there from the beginning."""
    sigma_rotation: float
    """Standard deviation, radians; root of the sum over the axes."""
    sigma_translation_m: float
    """The same of the translation."""
    shift: float
    """By how much the move changes the angles between rays, root mean square, in their standard deviations."""
    shift_m: float
    """The same of the distances by which the rays miss each other at the body."""
    of_most_joints: float
    """Share of the gain that is left without the two joints that gain most: a limb that a camera shows elsewhere."""
    end_edges: tuple[int, int] | None = None
    """The same of the block after a bump that begins and ends."""
    untouched: float = 0.0
    """How probably one of as many cameras that nobody touched seems to have been moved as far, since their calibrations
    and detections err."""


@dataclass(frozen=True, eq=False)
class _Views:
    """A camera with each of the others, in the samples of all blocks."""

    own: Float[np.ndarray, "sample joint 3"]
    own_centre_m: Float[np.ndarray, "sample 3"]
    others: Float[np.ndarray, "other sample joint 3"]
    centres_m: Float[np.ndarray, "other sample 3"]
    weight: Float[np.ndarray, "other sample joint"]
    scale: Float[np.ndarray, " other"]
    blocks: Blocks

    @cached_property
    def reach_m(self) -> Float[np.ndarray, " other"]:
        """What an angle has to be multiplied by to be the distance by which the rays miss each other at the body; NaN
        where no rays meet."""
        return reach_m(self.own, self.others, (self.centres_m - self.own_centre_m)[:, :, None])

    @staticmethod
    def of(rays: Rays, costs: LagCosts, c: int) -> _Views:
        index, others = costs.blocks.index, [o for o in range(rays.n_cameras) if o != c]
        share = independent(costs.blocks)
        return _Views(
            rays.direction[c, index],
            rays.centre_m[c, index],
            rays.direction[others][:, index],
            rays.centre_m[others][:, index],
            share * np.minimum(rays.weight[c, index], rays.weight[others][:, index]),
            np.array([costs.scale[min(c, o), max(c, o)] for o in others]),
            costs.blocks,
        )

    def angles(self, move: Float[np.ndarray, " 6"]) -> Float[np.ndarray, "other sample joint"]:
        """Whitened, with the camera moved."""
        turned = self.own @ gtsam.Rot3.Expmap(move[:3]).matrix().T.astype(np.float32)
        baseline_m = (self.own_centre_m + move[3:] - self.centres_m)[:, :, None].astype(np.float32)
        return angle(self.others, turned[None], baseline_m) / self.scale[:, None, None]

    def jacobian(self, move: Float[np.ndarray, " 6"]) -> Float[np.ndarray, "other sample joint 6"]:
        turned, across, across_turned = self._across(move)
        by_move = np.concatenate([cross(turned, across), cross(self.others, turned)], axis=-1)
        return by_move / self._length(across, across_turned)

    def jacobian_of_others(self, move: Float[np.ndarray, " 6"]) -> Float[np.ndarray, "other sample joint 6"]:
        """The same by a move of the other camera, with the own one moved."""
        turned, across, across_turned = self._across(move)
        by_move = -np.concatenate([cross(self.others, across_turned), cross(self.others, turned)], axis=-1)
        return by_move / self._length(across, across_turned)

    def _across(self, move: Float[np.ndarray, " 6"]) -> tuple[Float[np.ndarray, "other sample joint 3"], ...]:
        """The rays of the camera with it moved, and what is across the baseline and those of the others, and these."""
        turned = np.broadcast_to(
            self.own @ gtsam.Rot3.Expmap(move[:3]).matrix().T.astype(np.float32), self.others.shape
        )
        baseline_m = (self.own_centre_m + move[3:] - self.centres_m)[:, :, None].astype(np.float32)
        return turned, cross(baseline_m, self.others), cross(baseline_m, turned)

    def _length(
        self,
        across: Float[np.ndarray, "other sample joint 3"],
        across_turned: Float[np.ndarray, "other sample joint 3"],
    ) -> Float[np.ndarray, "other sample joint 1"]:
        """What whitens; a ray along the baseline, or at a camera's centre, says nothing."""
        length = np.sqrt(dot(across, across) + dot(across_turned, across_turned))
        return np.where(length > 0, length * self.scale[:, None, None], np.inf)[..., None]

    def independent(self, used: Bool[np.ndarray, " block"]) -> float:
        """By how much the angles in these blocks count against the prior."""
        total = float(self.weight[:, used[self.blocks.block]].sum())
        return min(1.0, CalibrationConfig().independent_measurements * len(self.scale) / max(total, 1.0))

    def of_most_joints(
        self, before: Float[np.ndarray, "other sample joint"], after: Float[np.ndarray, "other sample joint"]
    ) -> float:
        """The share of what is better without the two joints of which most is; 1 of skeletons of few joints."""
        gain = np.sort((weighted(before, self.weight) - weighted(after, self.weight)).sum(axis=(0, 1)))
        return float(gain[:-_LIMB].sum() / max(gain.sum(), 1e-9)) if len(gain) >= _FEWEST_JOINTS else 1.0

    def cost(self, angles: Float[np.ndarray, "other sample joint"]) -> Float[np.ndarray, " block"]:
        each = weighted(angles, self.weight).sum(axis=(0, 2))
        return np.bincount(self.blocks.block, each, minlength=self.blocks.n_blocks)

    def equations(
        self, move: Float[np.ndarray, " 6"], width: float
    ) -> tuple[Float[np.ndarray, "block 6 6"], Float[np.ndarray, "block 6"]]:
        """Information and gradient of each block; the kernel is wider by this factor."""
        angles = self.angles(move)
        weight = reweighted(angles, self.weight, width)
        jacobian = np.nan_to_num(self.jacobian(move))
        information = np.einsum("osj,osja,osjb->sab", weight, jacobian, jacobian, optimize=True)
        gradient = np.einsum("osj,osj,osja->sa", weight, np.nan_to_num(angles), jacobian, optimize=True)
        n_blocks, block = self.blocks.n_blocks, self.blocks.block
        of_block = np.zeros((n_blocks, 6, 6)), np.zeros((n_blocks, 6))
        np.add.at(of_block[0], block, information)
        np.add.at(of_block[1], block, gradient)
        return of_block


def misses_m(rays: Rays, blocks: Blocks, c: int, held: Bool[np.ndarray, " block"]) -> float:
    """By how much the rays of a camera miss those of the others at the body in these blocks: the median, of the median
    of the others; infinite where they never meet."""
    index, found_m = blocks.index[held[blocks.block]], []
    own = rays.direction[c, index]
    for other in range(rays.n_cameras):
        seen = (np.minimum(rays.weight[c, index], rays.weight[other, index]) > 0) if other != c else np.zeros(0, bool)
        if seen.any():
            baseline_m = (rays.centre_m[other, index] - rays.centre_m[c, index])[:, None]
            rays_of_other = rays.direction[other, index]
            far_m = float(reach_m(own, rays_of_other[None], baseline_m[None])[0])
            apart = np.nan_to_num(np.abs(angle(own, rays_of_other, baseline_m)) * far_m, nan=np.inf)
            found_m.append(float(np.median(apart[seen])))
    return float(np.median(found_m)) if found_m else np.inf


def pose_fits(rays: Rays, costs: LagCosts, c: int) -> list[PoseFit]:
    """The best of each kind: moved all the time, bumped at a time, there only until a time, or only for a while."""
    views = _Views.of(rays, costs, c)
    told = np.bincount(costs.blocks.block, views.weight.sum(axis=(0, 2)), minlength=costs.blocks.n_blocks) > 0
    if told.sum() < 2 * MIN_BLOCKS:
        return []
    still = np.zeros(6)
    before = views.cost(views.angles(still))
    width = wide_enough(views.angles(still), views.weight)
    whole = views.equations(still, width)
    for_a_while = _between(*whole, told)
    one_sided = max(float(_in_sample(*whole, told, until=until).max()) for until in (False, True))
    if max(one_sided, for_a_while.gain) < LEAST_GAIN:
        return []
    found = [_fitted(Kind.MOVED, np.ones(len(told), dtype=bool), views, told, before, width)]
    for until in (False, True):
        held = _split(*whole, told, until=until)
        for _ in range(2):
            move = _move(views, held & told, width)
            held = _better(before - views.cost(views.angles(move)), told, until=until)
        found.append(_fitted(Kind.BUMP, held, views, told, before, width))
    held = for_a_while.held
    for _ in range(2 if held.any() else 0):
        move = _move(views, held & told, width)
        held = better_stretch(before - views.cost(views.angles(move)), told).held
    return [*found, _fitted(Kind.BUMP, held, views, told, before, width)] if held.any() else found


def pose_fit(rays: Rays, costs: LagCosts, c: int, kind: Kind, held: Bool[np.ndarray, " block"]) -> PoseFit:
    """The move of one kind that fits best if the camera was there in these blocks."""
    views = _Views.of(rays, costs, c)
    angles = views.angles(np.zeros(6))
    told = np.bincount(costs.blocks.block, views.weight.sum(axis=(0, 2)), minlength=costs.blocks.n_blocks) > 0
    return _fitted(kind, held, views, told, views.cost(angles), wide_enough(angles, views.weight))


def _split(
    information: Float[np.ndarray, "block 6 6"],
    gradient: Float[np.ndarray, "block 6"],
    told: Bool[np.ndarray, " block"],
    *,
    until: bool,
) -> Bool[np.ndarray, " block"]:
    """The blocks, from one on or until one, in which a move makes most better."""
    held = np.arange(len(told)) <= int(np.argmax(_in_sample(information, gradient, told, until=until)))
    return held if until else held[::-1]


def _in_sample(
    information: Float[np.ndarray, "block 6 6"],
    gradient: Float[np.ndarray, "block 6"],
    told: Bool[np.ndarray, " block"],
    *,
    until: bool,
) -> Float[np.ndarray, " block"]:
    """By how much all blocks until one, or from the last to one, are better with the move that suits them best."""
    order = slice(None) if until else slice(None, None, -1)
    H = np.cumsum(information[order], axis=0) + np.diag(_SIGMAS**-2)
    g, number = np.cumsum(gradient[order], axis=0), np.cumsum(told[order])
    better = 0.5 * np.einsum("bi,bi->b", g, np.linalg.solve(H, g[..., None])[..., 0])
    better[(number < MIN_BLOCKS) | (number[-1] - number < MIN_BLOCKS)] = -np.inf
    return better


def _better(
    gain: Float[np.ndarray, " block"], told: Bool[np.ndarray, " block"], *, until: bool
) -> Bool[np.ndarray, " block"]:
    order = slice(None) if until else slice(None, None, -1)
    total, number = np.cumsum(gain[order]), np.cumsum(told[order])
    total[(number < MIN_BLOCKS) | (number[-1] - number < MIN_BLOCKS)] = -np.inf
    return (np.arange(len(told)) <= int(np.argmax(total)))[order]


def _between(
    information: Float[np.ndarray, "block 6 6"],
    gradient: Float[np.ndarray, "block 6"],
    told: Bool[np.ndarray, " block"],
) -> Stretch:
    """The blocks between two in which the move that suits them best makes most better."""
    H = np.concatenate([np.zeros((1, 6, 6)), np.cumsum(information, axis=0)])
    g = np.concatenate([np.zeros((1, 6)), np.cumsum(gradient, axis=0)])
    first, end = stretches(told)
    own = g[end] - g[first]
    move = np.linalg.solve(H[end] - H[first] + np.diag(_SIGMAS**-2), own[..., None])[..., 0]
    return best_stretch(0.5 * np.einsum("bi,bi->b", own, move), first, end, len(told))


def _move(views: _Views, used: Bool[np.ndarray, " block"], width: float) -> Float[np.ndarray, " 6"]:
    """By iteratively reweighted least squares, the kernel at first as wide as the angles are."""
    move = np.zeros(6)
    for round_ in range(_ROUNDS):
        information, gradient = views.equations(move, max(1.0, width * 0.5**round_))
        share = views.independent(used)
        H = share * information[used].sum(axis=0) + np.diag(_SIGMAS**-2)
        move = move - np.linalg.solve(H, share * gradient[used].sum(axis=0) + move * _SIGMAS**-2)
    return move


def _fitted(
    kind: Kind,
    held: Bool[np.ndarray, " block"],
    views: _Views,
    told: Bool[np.ndarray, " block"],
    before: Float[np.ndarray, " block"],
    width: float,
) -> PoseFit:
    used = held & told
    odd = np.cumsum(told) % 2 == 1
    gain = np.zeros(len(told))
    for half in (odd, ~odd):
        other = used & ~half
        gain[other] = (before - views.cost(views.angles(_move(views, used & half, width))))[other]
    move = _move(views, used, width)
    angles = views.angles(np.zeros(6)), views.angles(move)
    errors = _errors(views, move, angles[1], used)
    changed, samples = angles[1] - angles[0], used[views.blocks.block][None, :, None]
    there = (views.weight > 0) & samples & np.isfinite(changed)
    sigma, sigma_m = (errors.sigma(rows) for rows in (slice(0, 3), slice(3, 6)))
    shift_m = _root_mean_square((changed * (views.scale * views.reach_m)[:, None, None])[there])
    costs = before * told, views.cost(angles[1]) * told
    edges, end_edges = _edges(*costs, held)
    of_most = views.of_most_joints(*(np.where(samples, each, np.nan) for each in angles))
    shift = _root_mean_square(changed[there])
    untouched = errors.untouched(move) * (len(views.scale) + 1)  # Bonferroni
    return PoseFit(
        kind, move[:3], move[3:], held, gain, edges, sigma, sigma_m, shift, shift_m, of_most, end_edges, untouched
    )


def _edges(
    cost_before: Float[np.ndarray, " block"], cost_after: Float[np.ndarray, " block"], held: Bool[np.ndarray, " block"]
) -> tuple[tuple[int, int], tuple[int, int] | None]:
    """See PoseFit."""
    if held[-1]:
        return edges_as_good(cost_before, cost_after), None
    if held[0]:
        return edges_as_good(cost_after, cost_before), None
    middle = int(np.flatnonzero(held).mean())
    begin, end = slice(None, middle + 1), slice(middle, None)
    first, last = edges_as_good(cost_after[end], cost_before[end])
    return edges_as_good(cost_before[begin], cost_after[begin]), (middle + first, middle + last)


def _errors(
    views: _Views,
    move: Float[np.ndarray, " 6"],
    angles: Float[np.ndarray, "other sample joint"],
    used: Bool[np.ndarray, " block"],
) -> MoveErrors:
    samples = used[views.blocks.block][:, None]
    seen = Linearised(
        np.nan_to_num(angles),
        np.where(samples, reweighted(angles, views.weight, 1.0), 0.0),
        np.nan_to_num(views.jacobian(move)),
        np.nan_to_num(views.jacobian_of_others(move)),
    )
    share = views.independent(used)
    information = np.einsum("osj,osja,osjb->ab", seen.weight, seen.by_own, seen.by_own, optimize=True)
    inverse = np.linalg.inv(share * information + np.diag(_SIGMAS**-2))
    return move_errors(seen, inverse, share, _SIGMAS, views.blocks.block)


def _root_mean_square(values: Float[np.ndarray, " value"]) -> float:
    """Of those that are known; 0 without any."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else 0.0
