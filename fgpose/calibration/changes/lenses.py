"""Another lens than the calibration's, of one camera or of all alike; told by blocks that did not enter."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from fgpose.calibration.changes.clock_changes import MIN_BLOCKS
from fgpose.calibration.changes.lag_costs import (
    LEAST_GAIN,
    LagCosts,
    angle,
    independent,
    reweighted,
    weighted,
    wide_enough,
)
from fgpose.calibration.changes.rays import Rays
from fgpose.geometry.camera import Camera, CameraRig
from fgpose.geometry.intrinsics import shifted, stretched, zoomed
from fgpose.geometry.vectors import cross

_LOGARITHMS = np.linspace(-0.48, 0.48, 13)
_SHIFTS = np.linspace(-0.24, 0.24, 13)
_DISTORTIONS = np.linspace(-0.42, 0.42, 13).round(2)  # of k1: action cameras have -0.4; 0 is exact
_K2 = 1.2  # k2 over the square of k1 of wide lenses; equidistant ones have 1.8
_STEP = 0.02  # of the value, for derivatives
_LOST = 5.0  # whitened angle of a ray that another lens cannot have seen


class Lens(Enum):
    """In what another lens may differ, and what its value is."""

    FOCAL_LENGTH = "logarithm of the true focal length over that of the calibration"
    WIDTH = "logarithm of the true horizontal focal length over that of the calibration"
    HEIGHT = "logarithm of the true vertical focal length over that of the calibration"
    CENTRE_X = "shift of the principal point in x, in focal lengths; of all cameras: of one it is a rotation"
    CENTRE_Y = "shift of the principal point in y, in focal lengths; of all cameras"
    DISTORTION = "k1, where the calibration has no distortion"
    OTHER_DISTORTION = "change of k1, where it has another"
    NONE_LEFT = "1: the keypoints have no distortion, where the calibration has"
    SIGN = "1: the distortion has the other sign"
    ORDER = "1: k3 was written before p1 and p2"
    PINHOLE = "1: coefficients of a fisheye lens (Kannala-Brandt) are those of a pinhole"
    FISHEYE = "1: coefficients of a pinhole are those of a fisheye lens"

    @property
    def values(self) -> Float[np.ndarray, " value"]:
        """That are tried, with 0, the lens of the calibration."""
        if self in (Lens.FOCAL_LENGTH, Lens.WIDTH, Lens.HEIGHT):
            return _LOGARITHMS
        if self.is_shift:
            return _SHIFTS
        return _DISTORTIONS if self in (Lens.DISTORTION, Lens.OTHER_DISTORTION) else np.array([0.0, 1.0])

    @property
    def is_shift(self) -> bool:
        """Whether it is the centre of the image that is elsewhere."""
        return self in (Lens.CENTRE_X, Lens.CENTRE_Y)

    def applies(self, camera: Camera) -> bool:
        """Whether it is another lens for this camera."""
        distorts, fisheye = bool(camera.distortion.any()), camera.lens == "fisheye"
        if self is Lens.DISTORTION:
            return not distorts and not fisheye
        if self is Lens.ORDER:
            return not fisheye and len(camera.distortion) == 5 and distorts  # k1 k2 p1 p2 k3
        if self in (Lens.FISHEYE, Lens.OTHER_DISTORTION):
            return not fisheye and distorts and len(camera.distortion) in (4, 5)
        if self is Lens.PINHOLE:
            return fisheye
        return distorts or fisheye if self in (Lens.NONE_LEFT, Lens.SIGN) else True

    def of(self, camera: Camera, value: float) -> Camera:
        """The camera with this lens."""
        if not value:
            return camera
        given = camera.distortion
        match self:
            case Lens.FOCAL_LENGTH:
                return zoomed(camera, float(np.exp(value)))
            case Lens.WIDTH | Lens.HEIGHT:
                return stretched(camera, float(np.exp(value)), axis=0 if self is Lens.WIDTH else 1)
            case Lens.CENTRE_X | Lens.CENTRE_Y:
                return shifted(camera, value, axis=0 if self is Lens.CENTRE_X else 1)
            case Lens.DISTORTION:
                return replace(camera, distortion=distortion_of(value))
            case Lens.OTHER_DISTORTION:
                change = distortion_of(given[0] + value) - distortion_of(given[0])
                return replace(camera, distortion=given + np.pad(change, (0, len(given) - len(change))))
            case Lens.NONE_LEFT:
                return replace(camera, distortion=np.zeros(0), lens="pinhole")
            case Lens.SIGN:
                return replace(camera, distortion=-given)
            case Lens.ORDER:
                return replace(camera, distortion=given[[0, 1, 3, 4, 2]])
            case Lens.PINHOLE:
                return replace(camera, lens="pinhole")
            case Lens.FISHEYE:
                return replace(camera, distortion=given[:4], lens="fisheye")


def distortion_of(k1: float) -> Float[np.ndarray, " 4"]:
    """Of a lens with this first coefficient, if it is like others: k1, k2, p1, p2."""
    return np.array([k1, _K2 * k1**2, 0.0, 0.0])


@dataclass(frozen=True, eq=False)
class LensFit:
    """The other lens that fits best."""

    lens: Lens
    cameras: tuple[int, ...]
    """One or all."""
    value: float
    gain: Float[np.ndarray, " block"]
    """By how much the cost of each block is less, with a value to which it has not contributed."""
    shift_rad: float
    """By how much it moves rays, root mean square."""
    focal_px: float
    """Of the calibration; the median of the cameras."""
    or_else: LensFit | None = None
    """Another kind that fits as well: this recording does not tell which. Where people stand as high in all images, a
    shift in y is like another vertical focal length."""

    @property
    def factor(self) -> float:
        """Of a focal length."""
        return float(np.exp(self.value))


_Across = tuple[Float[np.ndarray, "sample joint"], Float[np.ndarray, "sample joint"]]


@dataclass(frozen=True, eq=False)
class _Pair:
    """What two cameras saw at the samples of all blocks."""

    cameras: tuple[int, int]
    baseline_m: Float[np.ndarray, "sample 1 3"]
    weight: Float[np.ndarray, "sample joint"]
    scale: float
    across: tuple[_Across, _Across]
    """Of both, with the lenses of the calibration."""
    cost: Float[np.ndarray, " sample"]
    """With these lenses: another one of other cameras does not change it."""

    @staticmethod
    def of(rays: Rays, costs: LagCosts, seen: list[_Seen], a: int, b: int) -> _Pair:
        index, views = costs.blocks.index, (seen[a].view, seen[b].view)
        baseline_m = (rays.centre_m[b, index] - rays.centre_m[a, index])[:, None].astype(np.float32)
        weight = independent(costs.blocks) * np.minimum(rays.weight[a, index], rays.weight[b, index])
        across = views[0].across(baseline_m), views[1].across(baseline_m)
        pair = _Pair((a, b), baseline_m, weight, costs.scale[a, b], across, np.zeros(len(index)))
        return replace(pair, cost=pair.cost_of(*views))

    def cost_of(self, one: _View, other: _View) -> Float[np.ndarray, " sample"]:
        return weighted(self.angles(one, other), self.weight).sum(axis=1)

    def angles(self, one: _View, other: _View) -> Float[np.ndarray, "sample joint"]:
        """Whitened. The longer a focal length is, the smaller is the angle of a pixel, in which detections err."""
        angles = angle(one.direction, other.direction, self.baseline_m) / self.scale
        if not (one.is_of_calibration and other.is_of_calibration):
            of_views = zip((one, other), self.across, strict=True)
            across = (given if view.is_of_calibration else view.across(self.baseline_m) for view, given in of_views)
            angles = angles * np.sqrt(squared_pixel(*self.across) / squared_pixel(*across))
        return np.where(one.lost | other.lost, _LOST, angles)


@dataclass(frozen=True, eq=False)
class _View:
    """What one camera saw at the samples, with some lens."""

    direction: Float[np.ndarray, "sample joint 3"]
    world_R_camera: Float[np.ndarray, "sample 3 3"]
    magnified: tuple[float, float] = (1.0, 1.0)
    """Focal lengths over those of the calibration, along x and y."""
    is_of_calibration: bool = True
    lost: Bool[np.ndarray, "sample joint"] | bool = False
    """What this lens cannot have seen."""

    def across(self, baseline_m: Float[np.ndarray, "sample 1 3"]) -> _Across:
        """Of the planes of a baseline and the rays: the squared length of the product of both, and the squared angle of
        a pixel across the plane, in focal lengths of the calibration. It is less at the edge of an image."""
        normal = np.einsum("sji,skj->ski", self.world_R_camera, cross(baseline_m, self.direction))
        squared = np.sum(normal**2, axis=-1)
        along_axis = np.einsum("sj,skj->sk", self.world_R_camera[..., 2], self.direction)
        of_pixel = np.sum((normal[..., :2] / self.magnified) ** 2, axis=-1) * along_axis**2
        return squared, of_pixel / np.maximum(squared, 1e-12)


def squared_pixel(one: _Across, other: _Across) -> Float[np.ndarray, "sample joint"]:
    """Variance of the angle by which two rays miss each other (lag_costs.angle) for a pixel of error in either image.
    Without it, cameras that look in parallel would agree better the shorter their focal lengths are, which they cannot
    tell."""
    (from_one, of_one), (from_other, of_other) = one, other
    return (from_other * of_one + from_one * of_other) / np.maximum(from_one + from_other, 1e-12)


@dataclass(frozen=True, eq=False)
class _Seen:
    """What one camera saw at the samples, in its own frame."""

    camera: Camera
    direction: Float[np.ndarray, "sample joint 3"]
    world_R_camera: Float[np.ndarray, "sample 3 3"]

    @property
    def view(self) -> _View:
        return _View(self.direction, self.world_R_camera)

    @cached_property
    def _normalized(self) -> Float[np.ndarray, "sample joint 2"]:
        own = np.einsum("sji,skj->ski", self.world_R_camera, self.direction)
        return own[..., :2] / np.where(own[..., 2:] > 0, own[..., 2:], np.nan)

    @cached_property
    def _px(self) -> Float[np.ndarray, "sample joint 2"]:
        """In the image as it was taken, which every lens has to explain."""
        return self.camera.distort(self._normalized * np.diag(self.camera.K)[:2] + self.camera.K[:2, 2])

    def through(self, lens: Lens, value: float) -> _View:
        other = lens.of(self.camera, value)
        if other is self.camera:
            return self.view
        normalized, changed = self._normalized, (other.undistort(self._px) - other.K[:2, 2]) / np.diag(other.K)[:2]
        known, lost = np.isfinite(changed), np.isfinite(normalized) & ~np.isfinite(changed)
        x, y = _spreads(normalized) / np.maximum(_spreads(changed), 1e-9) if known.any() else (1.0, 1.0)
        magnified = float(x), float(y)
        rays = np.concatenate([changed, np.ones((*changed.shape[:-1], 1))], axis=-1)
        rays = np.einsum("sij,skj->ski", self.world_R_camera, rays / np.linalg.norm(rays, axis=-1, keepdims=True))
        return _View(rays, self.world_R_camera, magnified, is_of_calibration=False, lost=np.asarray(lost.any(axis=-1)))


def _spreads(points: Float[np.ndarray, "sample joint 2"]) -> Float[np.ndarray, " 2"]:
    """Of an image along both axes, about its middle."""
    return np.nanmedian(np.abs(points - np.nanmedian(points, axis=(0, 1))), axis=(0, 1))


def lens_fits(rays: Rays, costs: LagCosts, rig: CameraRig, told: Callable[[], object] = lambda: None) -> list[LensFit]:
    """The best of each kind, of each camera and of all alike, that is not plainly none; of people who walk
    (somebody_walks); told after each kind."""
    if costs.blocks.n_blocks < 2 * MIN_BLOCKS:
        return []
    index = costs.blocks.index
    seen = [
        _Seen(camera, rays.direction[c, index], rays.world_R_camera[c, index]) for c, camera in enumerate(rig.cameras)
    ]
    pairs = [_Pair.of(rays, costs, seen, a, b) for a, b in costs.pairs]
    everybody = tuple(range(rays.n_cameras))
    found = []
    for lens in Lens:
        able = [c for c in everybody if lens.applies(rig.cameras[c])]
        groups = [everybody] if len(able) == len(everybody) > 1 else []
        groups += [(c,) for c in able if not lens.is_shift]
        found += [_fitted(lens, group, pairs, seen, costs) for group in _promising(lens, groups, pairs, seen)]
        told()
    return found


def with_lens(rig: CameraRig, fit: LensFit) -> CameraRig:
    """The rig with these lenses."""
    cameras = [fit.lens.of(each, fit.value) if c in fit.cameras else each for c, each in enumerate(rig.cameras)]
    return CameraRig(tuple(cameras))


def _promising(
    lens: Lens, groups: list[tuple[int, ...]], pairs: list[_Pair], seen: list[_Seen]
) -> Iterator[tuple[int, ...]]:
    """Groups of cameras with which all blocks together agree better, as far as derivatives tell."""
    if len(lens.values) == 2 or not groups:
        yield from groups
        return
    information, gradient = np.zeros(len(groups)), np.zeros(len(groups))
    stepped = {c: seen[c].through(lens, _STEP) for group in groups for c in group}
    for pair in pairs:
        a, b = pair.cameras
        views = seen[a].view, seen[b].view
        still = pair.angles(*views)
        weight = reweighted(still, pair.weight, wide_enough(still, pair.weight))
        by_one = (pair.angles(stepped.get(a, views[0]), views[1]) - still) / _STEP
        by_other = (pair.angles(views[0], stepped.get(b, views[1])) - still) / _STEP
        for g, group in enumerate(groups):
            slope = np.nan_to_num(by_one * (a in group) + by_other * (b in group))
            information[g] += np.sum(weight * slope**2)
            gradient[g] += np.sum(weight * slope * np.nan_to_num(still))
    gain = 0.5 * gradient**2 / np.maximum(information, 1e-12)
    yield from (group for group, better in zip(groups, gain.tolist(), strict=True) if better > LEAST_GAIN)


def _fitted(lens: Lens, group: tuple[int, ...], pairs: list[_Pair], seen: list[_Seen], costs: LagCosts) -> LensFit:
    cost = np.array([_cost(lens, group, pairs, seen, costs, float(value)) for value in lens.values])
    tried = dict(zip(lens.values.tolist(), cost, strict=True))
    odd = np.arange(costs.blocks.n_blocks) % 2 == 1
    gain = np.zeros(costs.blocks.n_blocks)
    for half in (odd, ~odd):
        # Not on a line between those that were tried: small shifts would lose against what they look like.
        best = _best(lens, cost[:, half])
        other = tried[best] if best in tried else _cost(lens, group, pairs, seen, costs, best)
        gain[~half] = (tried[0.0] - other)[~half]
    value = _best(lens, cost)
    moved = [np.linalg.norm(seen[c].through(lens, value).direction - seen[c].direction, axis=-1) for c in group]
    focal_px = float(np.median([seen[c].camera.K[0, 0] for c in group]))
    return LensFit(lens, group, value, gain, float(np.sqrt(np.nanmean(np.square(moved)))), focal_px)


def _cost(
    lens: Lens, group: tuple[int, ...], pairs: list[_Pair], seen: list[_Seen], costs: LagCosts, value: float
) -> Float[np.ndarray, " block"]:
    """Of each block, with the lenses of these cameras changed."""
    views = [own.through(lens, value) if c in group else own.view for c, own in enumerate(seen)]
    per_sample = np.zeros(len(costs.blocks.index))
    for pair in pairs:
        with_others = not set(group).isdisjoint(pair.cameras)
        per_sample += pair.cost_of(*(views[c] for c in pair.cameras)) if with_others else pair.cost
    return np.bincount(costs.blocks.block, per_sample, minlength=costs.blocks.n_blocks)


def _best(lens: Lens, cost: Float[np.ndarray, "value block"]) -> float:
    """The value with the least cost; between those that were tried by a parabola."""
    total, values = cost.sum(axis=1), lens.values
    if len(values) == 2:
        return float(values[np.argmin(total)])
    k = int(np.clip(np.argmin(total), 1, len(total) - 2))
    before, here, after = total[k - 1 : k + 2]
    bend, step = before - 2 * here + after, float(values[1] - values[0])
    return float(values[k] + (np.clip(0.5 * (before - after) / bend, -1, 1) * step if bend > 0 else 0.0))
