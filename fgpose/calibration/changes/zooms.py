"""Another focal length than the calibration's, of one camera or of all alike; told by blocks that did not enter."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.calibration.changes.clock_changes import MIN_BLOCKS
from fgpose.calibration.changes.lag_costs import KERNEL, LagCosts, angle, independent, robust
from fgpose.calibration.changes.rays import Rays
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.intrinsics import zoomed

_LOGARITHMS = np.linspace(-0.48, 0.48, 13)
_STEP = 0.02  # of the logarithm, for derivatives
# In-sample gain below which the blocks that did not enter need not be asked.
_LEAST_GAIN = 20.0


@dataclass(frozen=True, eq=False)
class ZoomFit:
    """The focal length that fits best."""

    cameras: tuple[int, ...]
    """One or all."""
    factor: float
    """The true focal length over that of the calibration."""
    gain: Float[np.ndarray, " block"]
    """By how much the cost of each block is less, with a factor to which it has not contributed."""


@dataclass(frozen=True, eq=False)
class _Pair:
    """What two cameras saw at the samples of all blocks."""

    cameras: tuple[int, int]
    rays: tuple[Float[np.ndarray, "sample joint 3"], Float[np.ndarray, "sample joint 3"]]
    axes: tuple[Float[np.ndarray, "sample 3"], Float[np.ndarray, "sample 3"]]
    baseline_m: Float[np.ndarray, "sample 1 3"]
    weight: Float[np.ndarray, "sample joint"]
    scale: float

    def angles(self, logarithms: tuple[float, float]) -> Float[np.ndarray, "sample joint"]:
        """Whitened, with both focal lengths changed by so much. The longer one is, the smaller is the angle of a pixel,
        in which detections err."""
        one, other = (_rays_zoomed(*each) for each in zip(self.rays, self.axes, logarithms, strict=True))
        per_pixel = np.sqrt(np.mean(np.exp(2 * np.array(logarithms))))
        return angle(one, other, self.baseline_m) * (per_pixel / self.scale)


def zoom_fits(rays: Rays, costs: LagCosts) -> list[ZoomFit]:
    """The best of each camera, and of all alike, that is not plainly none; of people who walk (somebody_walks)."""
    if costs.blocks.n_blocks < 2 * MIN_BLOCKS:
        return []
    pairs = list(_pairs(rays, costs))
    everybody = tuple(range(rays.n_cameras))
    groups = (everybody, *((c,) for c in everybody))
    return [_fitted(group, pairs, costs) for group in _promising(groups, pairs)]


def with_zoom(rig: CameraRig, fit: ZoomFit) -> CameraRig:
    """The rig with these focal lengths."""
    cameras = [zoomed(each, fit.factor) if c in fit.cameras else each for c, each in enumerate(rig.cameras)]
    return CameraRig(tuple(cameras))


def _pairs(rays: Rays, costs: LagCosts) -> Iterator[_Pair]:
    index, share = costs.blocks.index, independent(costs.blocks)
    for a, b in costs.pairs:
        yield _Pair(
            (a, b),
            (rays.direction[a, index], rays.direction[b, index]),
            (rays.axis[a, index], rays.axis[b, index]),
            (rays.centre_m[b, index] - rays.centre_m[a, index])[:, None].astype(np.float32),
            share * np.minimum(rays.weight[a, index], rays.weight[b, index]),
            costs.scale[a, b],
        )


def _rays_zoomed(
    rays: Float[np.ndarray, "sample joint 3"], axes: Float[np.ndarray, "sample 3"], logarithm: float
) -> Float[np.ndarray, "sample joint 3"]:
    """Unit vectors nearer to the optical axis the longer the focal length is."""
    if not logarithm:
        return rays
    axis = axes[:, None].astype(np.float32)
    ahead = np.sum(rays * axis, axis=-1, keepdims=True)
    nearer = rays + ahead * (np.exp(logarithm) - 1) * axis
    return nearer / np.linalg.norm(nearer, axis=-1, keepdims=True)


def _promising(groups: tuple[tuple[int, ...], ...], pairs: list[_Pair]) -> Iterator[tuple[int, ...]]:
    """Groups of cameras with which all blocks together agree better, as far as derivatives tell."""
    information, gradient = np.zeros(len(groups)), np.zeros(len(groups))
    for pair in pairs:
        still = pair.angles((0.0, 0.0))
        known = (pair.weight > 0) & np.isfinite(still)
        width = max(1.0, float(np.quantile(np.abs(still[known]), 0.8))) if known.any() else 1.0
        weight = np.where(known, pair.weight / (1 + (np.nan_to_num(still) / (width * KERNEL)) ** 2), 0.0)
        by_one, by_other = ((pair.angles(step) - still) / _STEP for step in ((_STEP, 0.0), (0.0, _STEP)))
        for g, group in enumerate(groups):
            slope = np.nan_to_num(by_one * (pair.cameras[0] in group) + by_other * (pair.cameras[1] in group))
            information[g] += np.sum(weight * slope**2)
            gradient[g] += np.sum(weight * slope * np.nan_to_num(still))
    gain = 0.5 * gradient**2 / np.maximum(information, 1e-12)
    return (group for group, better in zip(groups, gain.tolist(), strict=True) if better > _LEAST_GAIN)


def _fitted(group: tuple[int, ...], pairs: list[_Pair], costs: LagCosts) -> ZoomFit:
    cost = np.array([_cost(group, pairs, costs, float(logarithm)) for logarithm in _LOGARITHMS])
    odd = np.arange(costs.blocks.n_blocks) % 2 == 1
    still, gain = _at(cost, 0.0), np.zeros(costs.blocks.n_blocks)
    for half in (odd, ~odd):
        gain[~half] = (still - _at(cost, _best(cost[:, half])))[~half]
    return ZoomFit(group, float(np.exp(_best(cost))), gain)


def _cost(group: tuple[int, ...], pairs: list[_Pair], costs: LagCosts, logarithm: float) -> Float[np.ndarray, " block"]:
    """Of each block, with the focal lengths of these cameras changed."""
    per_sample = np.zeros(len(costs.blocks.index))
    for pair in pairs:
        a, b = pair.cameras
        angles = pair.angles((logarithm * (a in group), logarithm * (b in group)))
        per_sample += np.where(pair.weight > 0, pair.weight * np.nan_to_num(robust(angles, 1.0)), 0.0).sum(axis=1)
    return np.bincount(costs.blocks.block, per_sample, minlength=costs.blocks.n_blocks)


def _best(cost: Float[np.ndarray, "factor block"]) -> float:
    """The logarithm with the least cost; between the factors by a parabola."""
    total = cost.sum(axis=1)
    k = int(np.clip(np.argmin(total), 1, len(total) - 2))
    before, here, after = total[k - 1 : k + 2]
    bend = before - 2 * here + after
    step = float(_LOGARITHMS[1] - _LOGARITHMS[0])
    return float(_LOGARITHMS[k] + (np.clip(0.5 * (before - after) / bend, -1, 1) * step if bend > 0 else 0.0))


def _at(cost: Float[np.ndarray, "factor block"], logarithm: float) -> Float[np.ndarray, " block"]:
    """Between the factors of each block, on the line."""
    return np.array([np.interp(logarithm, _LOGARITHMS, of_block) for of_block in cost.T])
