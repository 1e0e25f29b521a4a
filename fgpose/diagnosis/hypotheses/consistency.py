"""How well cameras agree on where the joints are, in metres at the body.

Every pair of cameras proposes a place for a joint, where their rays pass each other; the place to which most rays come
near wins, and is put where those rays come nearest together. It is the agreement of triangulate_robust, but its
threshold is a length, so that it is the same for all lenses and resolutions.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.diagnosis.hypotheses.scene import SynchronousViews
from fgpose.geometry.vectors import dot
from fgpose.sampling import spread_evenly

# A detection misses the joint by 18 mm along each axis of the image (VisibilityConfig.sigma_m), and by a bias of 20 to
# 40 mm that depends on the side from which the body is seen. A ray that passes by at three times as much as both
# together is of something else.
NEAR_M = 0.12
# A body whose joints are spread by 0.5 m (body_size.body_radius) may be a child's, or crouch. Further from it the
# unit is wrong, and distances are measured in bodies.
SPREAD_M, _MOST_TIMES = 0.45, 2.5
_LEAST_SIN = np.sin(np.deg2rad(2.0))  # between two rays that propose a place
_MAX_PAIRS = 28
# Of the joints that two cameras see, so many are seen by a third: else few moments would speak for all.
_BY_THREE = 0.1
# Of real detectors seen by two cameras, where errors along the epipolar lines go unnoticed: see unsteadiness.
STEADY = 0.25


@dataclass(frozen=True, eq=False)
class Consistency:
    """Of a scene."""

    positions_m: Float[np.ndarray, "frame joint 3"]
    """Where the rays that agree come nearest together; NaN where no two do."""
    distance_m: Float[np.ndarray, "frame joint camera"]
    """Of each ray from there, on a body of usual size; infinite if there is no such ray, NaN = missing."""
    unit: float
    """What positions_m has to be multiplied by to be metres of a body of usual size; 1 where they may be metres."""

    @cached_property
    def judged(self) -> Bool[np.ndarray, "frame joint camera"]:
        """Detections of joints that others see too: three cameras in all; of two both, where more hardly ever see the
        same."""
        seen = ~np.isnan(self.distance_m)
        n_views = seen.sum(axis=-1, keepdims=True)
        by_three, by_two = np.asarray(n_views >= 3), np.asarray(n_views >= 2)
        return np.asarray(seen & (by_three if by_three.sum() > _BY_THREE * by_two.sum() else by_two))

    @cached_property
    def cost(self) -> float:
        """Mean of the squared distances, in units of NEAR_M and no more than 1 each; NaN if nothing can be judged."""
        return self.cost_if_larger(1.0)

    def cost_if_larger(self, times: float) -> float:
        """The same if distances are so many times as large."""
        if not self.judged.any():
            return np.nan
        return float(np.mean(np.minimum((times * self.distance_m[self.judged] / NEAR_M) ** 2, 1.0)))

    @cached_property
    def costs(self) -> Float[np.ndarray, " camera"]:
        """The same of each camera."""
        cost = np.where(self.judged, np.minimum((self.distance_m / NEAR_M) ** 2, 1.0), 0.0).sum(axis=(0, 1))
        n_judged = self.judged.sum(axis=(0, 1))
        return np.where(n_judged > 0, cost / np.maximum(n_judged, 1), np.nan)

    @cached_property
    def shares(self) -> Float[np.ndarray, " camera"]:
        """Of the detections of each camera that can be judged, how many come near."""
        near = (self.judged & (self.distance_m < NEAR_M)).sum(axis=(0, 1))
        return near / np.maximum(self.judged.sum(axis=(0, 1)), 1)

    @property
    def median_m(self) -> float:
        """Distance of half of the detections that can be judged; NaN without any."""
        return float(np.median(self.distance_m[self.judged])) if self.judged.any() else np.nan


def consistency(scene: SynchronousViews) -> Consistency:
    """Of all views of a scene."""
    shape, origins_m = scene.seen.shape, scene.origins_m
    rays = scene.rays.reshape(-1, *scene.rays.shape[2:])
    known = np.asarray(np.isfinite(rays[..., 0]))
    rays = np.where(known[..., None], rays, 0.0)
    proposals_m = _proposals(rays, known, origins_m)
    depth_m, distance_m = _seen_from(proposals_m, rays[:, None], origins_m)
    unit = _unit(scene, rays, known, depth_m)
    costs = np.minimum(unit / NEAR_M * distance_m, 1.0) ** 2
    best = np.argmin(np.where(known[:, None], costs, 0.0).sum(axis=-1), axis=1)
    chosen = np.arange(len(rays)), best
    near = known & (unit * distance_m[chosen] < NEAR_M)
    places_m = _refined(proposals_m[chosen], rays, near, origins_m)
    distance_m = np.where(known, unit * _seen_from(places_m, rays, origins_m)[1], np.inf).reshape(shape)
    distance_m[~scene.seen] = np.nan
    return Consistency(places_m.reshape(*shape[:2], 3), distance_m, unit)


def _pairs(n_cameras: int) -> Int[np.ndarray, "pair 2"]:
    pairs = np.array(list(combinations(range(n_cameras), 2)), dtype=int).reshape(-1, 2)
    return pairs[spread_evenly(len(pairs), _MAX_PAIRS)]


def _proposals(
    rays: Float[np.ndarray, "point camera 3"],
    known: Bool[np.ndarray, "point camera"],
    origins_m: Float[np.ndarray, "camera 3"],
) -> Float[np.ndarray, "point pair 3"]:
    """Middle between the rays of each pair where they are nearest; NaN if that is behind one, or they are parallel."""
    a, b = _pairs(len(origins_m)).T
    ray_a, ray_b, base_m = rays[:, a], rays[:, b], origins_m[b] - origins_m[a]
    cosine = dot(ray_a, ray_b)
    square = 1 - cosine**2
    usable = known[:, a] & known[:, b] & (square > _LEAST_SIN**2)
    square = np.where(usable, square, 1.0)
    along_a, along_b = dot(ray_a, base_m), dot(ray_b, base_m)
    depth_a, depth_b = (along_a - cosine * along_b) / square, (cosine * along_a - along_b) / square
    usable &= (depth_a > 0) & (depth_b > 0)
    places_m = (origins_m[a] + origins_m[b] + depth_a[..., None] * ray_a + depth_b[..., None] * ray_b) / 2
    return np.where(usable[..., None], places_m, np.nan)


def _seen_from(
    places_m: Float[np.ndarray, "*points 3"],
    rays: Float[np.ndarray, "*#points camera 3"],
    origins_m: Float[np.ndarray, "camera 3"],
) -> tuple[Float[np.ndarray, "*points camera"], Float[np.ndarray, "*points camera"]]:
    """How far away along each ray, and how far from it: infinite behind its camera, and where there is no place."""
    offset_m = places_m[..., None, :] - origins_m
    depth_m = dot(offset_m, rays)
    across_m = np.sqrt(np.maximum(dot(offset_m, offset_m) - depth_m**2, 0.0))
    return depth_m, np.where(depth_m > 0, across_m, np.inf)


def _refined(
    places_m: Float[np.ndarray, "point 3"],
    rays: Float[np.ndarray, "point camera 3"],
    near: Bool[np.ndarray, "point camera"],
    origins_m: Float[np.ndarray, "camera 3"],
) -> Float[np.ndarray, "point 3"]:
    """Where the near rays come nearest together, least squares."""
    enough = near.sum(axis=-1) >= 2
    across = np.where(near[..., None, None], np.eye(3) - rays[..., :, None] * rays[..., None, :], 0.0)
    normal, right = across.sum(axis=1), np.sum(across @ origins_m[..., None], axis=1)
    enough &= np.linalg.det(normal) > _LEAST_SIN**4
    solved = np.linalg.solve(np.where(enough[:, None, None], normal, np.eye(3)), right)[..., 0]
    return np.where(enough[:, None], solved, places_m)


def _unit(
    scene: SynchronousViews,
    rays: Float[np.ndarray, "point camera 3"],
    known: Bool[np.ndarray, "point camera"],
    depth_m: Float[np.ndarray, "point pair camera"],
) -> float:
    """By how large the body is in the images, as angles, and how far it is away."""
    depth_m = depth_m[known[:, None] & (depth_m > 0)]
    count = known.reshape(scene.seen.shape).sum(axis=1)
    mean = rays.reshape(*scene.seen.shape, 3).sum(axis=1) / np.maximum(count, 1)[..., None]
    angle = np.sqrt(np.maximum(1 - dot(mean, mean), 0.0))[count > 2]  # of unit vectors, around their mean
    if not depth_m.size or not angle.size or not np.median(angle) > 0:
        return 1.0
    unit = float(SPREAD_M / (np.median(depth_m) * np.median(angle)))
    return 1.0 if 1 / _MOST_TIMES < unit < _MOST_TIMES else unit


def unsteadiness(positions_m: Float[np.ndarray, "frame joint 3"], limbs: Int[np.ndarray, "limb side 2"]) -> float:
    """By how much the limbs change their lengths and differ between left and right, as a share of their lengths; the
    median over the limbs. 0.05 to 0.15 of a body that real detectors see; NaN without limbs."""
    if not len(limbs):
        return np.nan
    lengths_m = np.linalg.norm(positions_m[:, limbs[..., 0]] - positions_m[:, limbs[..., 1]], axis=-1)
    usual_m = _median_of_frames(lengths_m)
    usual_m = np.where(usual_m > 0, usual_m, np.nan)  # between a joint and itself
    change = _median_of_frames(np.abs(lengths_m - usual_m)) / usual_m
    difference = np.abs(usual_m[:, 0] - usual_m[:, 1]) / usual_m.mean(axis=-1)
    known = np.isfinite(difference)
    return float(np.median(change[known].mean(axis=-1)) + np.median(difference[known])) if known.any() else np.nan


def _median_of_frames(values: Float[np.ndarray, "frame limb side"]) -> Float[np.ndarray, "limb side"]:
    """Of what is known; NaN where three frames are not. Many times as fast as nanmedian."""
    if not len(values):
        return np.full(values.shape[1:], np.nan)
    rows = np.sort(values, axis=0)  # NaN last
    count = np.isfinite(values).sum(axis=0)
    middle = np.take_along_axis(rows, np.maximum(count // 2, 0)[None].clip(max=len(rows) - 1), axis=0)[0]
    return np.where(count >= 3, middle, np.nan)
