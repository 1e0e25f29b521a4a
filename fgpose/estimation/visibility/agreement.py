"""What all detections of a joint say together: that the joint is on the estimated path, or where they agree off it.

Against the path alone, every detection is judged by itself. A limb that is faster than the motion model expects is off
its path in all views at once, and each view by itself looks hallucinated. But detections that agree on a place are
stronger evidence than the path: hallucinations in several cameras rarely meet in a point, at the right distances from
the joints around it. So two hypotheses are compared over all views of a joint: it is on its path, or it is where most
views agree. Under either, each detection is of a visible joint or of a hidden one, and the place is integrated over
(Laplace's approximation). What a detection says for itself is then the mean over both, weighted by what the other
detections say for them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.config import VisibilityConfig
from fgpose.estimation.visibility.detection_residuals import (
    DetectionResiduals,
    LogDensities,
    log_density_fitted,
    log_density_hidden,
    log_density_visible,
    without_own,
)
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.reprojection import linearized_projection
from fgpose.geometry.triangulation import triangulate_robust
from fgpose.geometry.vectors import norm
from fgpose.skeleton import Skeleton

# How often a joint is off its path, and how far (a Cauchy distribution). A place three times as far costs as much as
# one that is off path ten times more rarely; several views that agree say thousands of times as much.
_OFF_PATH, _OFF_PATH_M = 0.05, 0.2
BONE_M = 0.03
"""Standard deviation of the length of a bone between places that several views give (Student's distribution)."""
# Standard deviation of a place along an axis that the views leave open.
_ANYWHERE_M = 1.0
# In standard deviations of a detection: what is off the path, and what agrees on a place.
_OFF, _AGREES = 2.5, 3.0
# Logarithm of the odds for a place from which it is believed although only two views agree on it.
_TWO_VIEWS = 1.0


@dataclass(frozen=True, eq=False)
class Agreement:
    """What is said with all views of each joint together."""

    log_odds: Float[np.ndarray, "frame camera joint"]
    """What each detection says for visible against hidden, given the others of its joint in its frame; 0 where nothing
    was detected."""
    off_path_m: Float[np.ndarray, "frame joint 3"]
    """Where the detections agree, if the joint is rather there than on its path; NaN elsewhere."""

    @staticmethod
    def of(
        residuals: DetectionResiduals,
        visible_m: Float[np.ndarray, "#frame camera #joint"],
        spread_m: Float[np.ndarray, "*#frame camera"],
        usual: Float[np.ndarray, "frame camera joint"],
        least: float,
        rig: CameraRig,
        skeleton: Skeleton,
        config: VisibilityConfig,
    ) -> Agreement:
        """Of the detections of some frames.

        Args:
            residuals: against the estimated path.
            visible_m: standard deviation of the residuals of visible detections along each axis of the image, with what
                the timing of fast joints adds.
            spread_m: the same of each camera, if all images are taken when they should be: those that agree are.
            usual: probability of visible before any residual is known.
            least: logarithm of the odds from which a place is believed on which three views agree.
            rig, skeleton, config: as for fgpose.estimation.visibility.visibility.judged.
        """
        on_path = residuals.log_densities(visible_m, rig, skeleton, config)
        log_odds, off_path_m = on_path.visible - on_path.hidden, np.full(residuals.positions_m.shape, np.nan)
        frames, joints = np.nonzero(_are_off(residuals.seen, residuals.length_m, spread_m[..., None]))
        if len(frames):
            points = _Points.of(residuals, on_path, visible_m, spread_m, (frames, joints))
            places = _Places.of(points, rig, skeleton, config)
            log_odds[frames, :, joints], odds = points.compared(places, usual[frames, :, joints])
            believed = odds > np.where(places.n_views > 2, least, _TWO_VIEWS)
            off_path_m[frames, joints] = np.where(believed[:, None], places.places_m, np.nan)
        return Agreement(np.where(residuals.seen, log_odds + residuals.prior_log_odds, 0.0), off_path_m)


def is_doubtful(length_m: Float[np.ndarray, "camera joint"], spread_m: Float[np.ndarray, " camera"]) -> bool:
    """Whether two detections of some joint are so far from it; NaN: nothing was detected."""
    return bool(_are_off(np.isfinite(length_m), length_m, spread_m[:, None]).any())


def _are_off(seen: np.ndarray, length_m: np.ndarray, spread_m: np.ndarray) -> Bool[np.ndarray, "*frame joint"]:
    """In which joints several detections are off."""
    return np.asarray((seen & (length_m > _OFF * spread_m)).sum(axis=-2) >= 2)


@dataclass(frozen=True, eq=False)
class _Points:
    """Joints in frames in which several detections are off the path."""

    at: tuple[Int[np.ndarray, " point"], Int[np.ndarray, " point"]]
    """Frame and joint."""
    positions_m: Float[np.ndarray, "frame joint 3"]
    undistorted_px: Float[np.ndarray, "point camera 2"]
    seen: Bool[np.ndarray, "point camera"]
    px_per_m: Float[np.ndarray, "point camera"]
    spread_px: Float[np.ndarray, "point camera"]
    on_path: LogDensities
    fitted: Float[np.ndarray, "point camera"]
    """Logarithm of the density of a detection if the joint is exactly on the path, and visible."""
    log_prior: Float[np.ndarray, " point"]
    """Of the path, integrated over what it leaves open."""

    @staticmethod
    def of(
        residuals: DetectionResiduals,
        on_path: LogDensities,
        visible_m: Float[np.ndarray, "#frame camera #joint"],
        spread_m: Float[np.ndarray, "*#frame camera"],
        at: tuple[Int[np.ndarray, " point"], Int[np.ndarray, " point"]],
    ) -> _Points:
        frames, joints = at

        def of_points(array: np.ndarray) -> np.ndarray:
            return array[frames, :, joints]

        px_per_m = of_points(residuals.px_per_m)
        visible_px = px_per_m * of_points(np.broadcast_to(visible_m, residuals.seen.shape))
        length_px = px_per_m * of_points(residuals.length_m)
        return _Points(
            at=at,
            positions_m=residuals.positions_m,
            undistorted_px=of_points(residuals.undistorted_px),
            seen=of_points(residuals.seen),
            px_per_m=px_per_m,
            spread_px=px_per_m * of_points(np.broadcast_to(spread_m[..., None], residuals.seen.shape)),
            on_path=LogDensities(*(of_points(array) for array in vars(on_path).values())),
            fitted=log_density_fitted(length_px, visible_px),
            log_prior=np.log(1 - _OFF_PATH) + residuals.log_occam[frames, joints],
        )

    def compared(
        self, places: _Places, usual: Float[np.ndarray, "point camera"]
    ) -> tuple[Float[np.ndarray, "point camera"], Float[np.ndarray, " point"]]:
        """What each detection says for visible against hidden; and the logarithm of the odds for the places against
        the path."""
        on, off = self.on_path, places.log_densities
        by_others_on, total_on = self._evidence(self.log_prior, self.fitted, on, usual)
        by_others_off, total_off = self._evidence(places.log_prior, places.fitted, off, usual)
        visible = np.logaddexp(by_others_on + on.visible, by_others_off + off.visible)
        hidden = np.logaddexp(by_others_on + on.hidden, by_others_off + off.hidden)
        return visible - hidden, total_off - total_on

    def _evidence(
        self, log_prior: Float[np.ndarray, " point"], fitted: np.ndarray, given: LogDensities, usual: np.ndarray
    ) -> tuple[Float[np.ndarray, "point camera"], Float[np.ndarray, " point"]]:
        """Of a hypothesis: of all detections but each, and of all."""
        if_visible, if_hidden = np.log(usual), np.log(1 - usual) + given.hidden
        each = np.where(self.seen, np.logaddexp(if_visible + fitted, if_hidden), 0.0)
        total = log_prior + each.sum(axis=1)
        return total[:, None] - np.logaddexp(if_visible + given.visible, if_hidden), total


@dataclass(frozen=True, eq=False)
class _Places:
    """Where most detections of each point agree."""

    places_m: Float[np.ndarray, "point 3"]
    n_views: Int[np.ndarray, " point"]
    """How many agree; 0 where none do."""
    log_densities: LogDensities
    fitted: Float[np.ndarray, "point camera"]
    log_prior: Float[np.ndarray, " point"]

    @staticmethod
    def of(points: _Points, rig: CameraRig, skeleton: Skeleton, config: VisibilityConfig) -> _Places:
        px, path_m = points.undistorted_px[:, :, None], points.positions_m[points.at]
        weights, inlier_px = points.seen[:, :, None].astype(float), _AGREES * points.spread_px[:, :, None]
        found = triangulate_robust(px, weights, rig, inlier_px)
        known = np.asarray(np.isfinite(found.positions_m).all(axis=-1))
        places_m = np.where(known, found.positions_m[:, 0], path_m)
        residual_px, jacobian, seen = linearized_projection(px, rig, places_m[:, None])
        agrees = found.inliers[:, 0] & seen[:, :, 0]
        information = np.where(agrees, points.spread_px**-2.0, 0.0)[:, :, None]
        others = without_own(residual_px, jacobian, information, _ANYWHERE_M)
        residual = (others.residual_px[:, :, 0], others.covariance_px2[:, :, 0])
        visible = log_density_visible(*residual, points.spread_px)
        hidden = log_density_hidden(*residual, config.hallucinated_m * points.px_per_m, points.on_path.other)
        log_prior = _log_density_off_path(places_m - path_m) + 1.5 * np.log(2 * np.pi)
        log_prior += 0.5 * np.linalg.slogdet(others.covariance_m2[:, 0])[1]
        log_prior += log_likelihood_of_bones(places_m, BONE_M, points.positions_m, points.at, skeleton)
        return _Places(
            places_m=places_m,
            n_views=np.where(known[:, 0], agrees.sum(axis=1), 0),
            log_densities=LogDensities(visible, hidden, points.on_path.other),
            fitted=log_density_fitted(norm(residual_px[:, :, 0]), points.spread_px),
            log_prior=np.where(known[:, 0], log_prior, -np.inf),
        )


def _log_density_off_path(away_m: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, " point"]:
    """Of a joint this far off its path, times how often it is off."""
    squared = np.sum(away_m**2, axis=-1) / _OFF_PATH_M**2
    return np.log(_OFF_PATH) - np.log(np.pi**2 * _OFF_PATH_M**3) - 2 * np.log1p(squared)


def log_likelihood_of_bones(
    places_m: Float[np.ndarray, "point 3"],
    sigma_m: float | Float[np.ndarray, "point 1"],
    positions_m: Float[np.ndarray, "frame joint 3"],
    at: tuple[Int[np.ndarray, " point"], Int[np.ndarray, " point"]],
    skeleton: Skeleton,
) -> Float[np.ndarray, " point"]:
    """Logarithm of how likely the lengths of the bones are from each place to the joints around it, which are as
    estimated or moved to their places too, relative to the lengths of the estimate.

    Args:
        places_m: where joints may be instead.
        sigma_m: standard deviation of the length of a bone (Student's distribution).
        positions_m: the estimate.
        at: frame and joint of each place.
        skeleton: for the bones.
    """
    moved_m, (frames, joints) = positions_m.copy(), at
    moved_m[at] = places_m
    neighbours = _neighbours(skeleton)[joints]
    beside = frames[:, None], neighbours
    length_m = norm(positions_m[at][:, None] - positions_m[beside])
    on, off = (np.abs(norm(places_m[:, None] - those[beside]) - length_m) for those in (positions_m, moved_m))
    off_m = np.where((neighbours >= 0) & np.isfinite(length_m), np.fmin(on, off), 0.0)
    return -2 * np.log1p((off_m / sigma_m) ** 2 / 2).sum(axis=1)


@lru_cache(maxsize=16)
def _neighbours(skeleton: Skeleton) -> Int[np.ndarray, "joint most"]:
    """The joints that bones join to each; -1 where it has fewer."""
    of_joint = [[sum(bone) - joint for bone in skeleton.bones if joint in bone] for joint in range(skeleton.n_joints)]
    most = max(map(len, of_joint), default=0)
    padded = [numbers + [-1] * (most - len(numbers)) for numbers in of_joint]
    return np.array(padded, dtype=int).reshape(skeleton.n_joints, most)
