"""Clocks that are wrong by so much that the tracker does not find people where they are in the image: seen at once.

A camera is compared with where the other cameras see people, without the tracker, which follows whom it believes. If a
clock is wrong, the others agree without its camera, and all agree with its images at another time.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from fgpose.calibration.disagreement import MAX_MRAD
from fgpose.finding import Code
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.triangulation import triangulate
from fgpose.live.tracking.common_sightings import CommonSighting
from fgpose_factors.robust_statistics import lower_medians

# Looks four times a second: what is wrong is said within two seconds.
EVERY_S = 0.25
_REMEMBERED_S, _NEWEST_S = 2.5, 1.25
_FEWEST = 3
_LAGS_S = np.arange(-15, 16) * 0.1
_NOW = len(_LAGS_S) // 2
# What is less may come from a camera that was moved a little, or from how a network sees somebody who turns.
_LEAST_S = 0.3
_SIGMAS = 3.0
# With the lag images must agree so much better with where people were: else it is no clock.
_LEFT = 0.4
# Without the camera that is wrong the others agree, to which so much more is no difference.
_NOT_BETTER = 1.5
# Between the lags that agree as well.
_KNOWN_TO_S = 0.5


class MotionLags:
    """Whether a camera sees people where they were some time ago, or where they will be.

    What was said stays until people who move are seen where they are. Two cameras cannot tell which of them is wrong:
    nothing is said of them, nor of the last two that are left.

    Args:
        rig: the cameras.
    """

    def __init__(self, rig: CameraRig) -> None:
        self._rig = rig
        self._focal_px = np.array([np.diag(camera.K)[:2] for camera in rig.cameras])
        self._matrices = rig.projection_matrices
        self._paths: dict[int, deque[_Look]] = {}
        self.faults: dict[str, str] = {}
        """By camera, in words."""

    def add(self, sighting: CommonSighting, sigma_s: Float[np.ndarray, " camera"]) -> None:
        """Somebody as all cameras see them, and what is not known of the clocks (standard deviations)."""
        path = self._paths.setdefault(sighting.person, deque())
        if path and not sighting.instant_s > path[-1].at_s:
            return
        path.append(self._looked(sighting))
        oldest_s = sighting.instant_s - _REMEMBERED_S
        while path[0].at_s < oldest_s:
            path.popleft()
        self._paths = {person: each for person, each in self._paths.items() if each[-1].at_s > oldest_s}
        allowed_s = np.maximum(_LEAST_S, _SIGMAS * sigma_s)
        lags = [self._lag(c, float(allowed_s[c])) for c in range(self._rig.n_cameras)]
        odd = self._odd_ones_out()
        suspects = {c: lag for c in odd if (lag := lags[c]) is not None and lag.lag_s}
        # Who cannot be told of may be the one.
        if suspects and all(lags[c] is not None for c in odd) and self._rig.n_cameras - len(self.faults) > 2:
            least_mrad = min(lag.left_mrad for lag in suspects.values())
            alike = {
                self._rig.names[c]: lag for c, lag in suspects.items() if lag.left_mrad <= _NOT_BETTER * least_mrad
            }
            for name, lag in alike.items():
                self.faults.setdefault(name, in_words(lag.lag_s, [other for other in alike if other != name]))
        for name, lag in zip(self._rig.names, lags, strict=True):
            if lag is not None and lag.lag_s == 0:
                self.faults.pop(name, None)

    def _odd_ones_out(self) -> list[int]:
        """The cameras without which the others agree as well as without any other, in the newest looks."""
        looks = [look.left_mrad for path in self._paths.values() for look in list(path)[-_FEWEST:]]
        mrad = np.array(looks).T
        known = np.isfinite(mrad)
        left_mrad = np.where(known.any(axis=1), _mean(mrad, known), np.inf)
        return np.flatnonzero(left_mrad <= _NOT_BETTER * left_mrad.min()).tolist()

    def _looked(self, sighting: CommonSighting) -> _Look:
        """Where the others see somebody, for each camera in turn; at once, for one triangulation costs as much."""
        others = ~np.eye(self._rig.n_cameras, dtype=bool)
        seen_px, confidence = sighting.undistorted_px.swapaxes(0, 1), sighting.confidence.T
        weights = np.where(others[:, None], confidence, 0.0)
        without_m = triangulate(np.broadcast_to(seen_px, (*weights.shape, 2)), weights, self._matrices)
        mrad = np.stack(
            [
                self._beside_mrad(c, without_m, sighting.undistorted_px[c], sighting.confidence[c])
                for c in range(len(others))
            ],
            axis=1,
        )
        left_mrad = lower_medians(np.where(others[..., None], mrad, np.nan).reshape(len(others), -1))
        return _Look(sighting.instant_s, sighting.undistorted_px, sighting.confidence, without_m, left_mrad)

    def _beside_mrad(
        self,
        c: int,
        positions_m: Float[np.ndarray, "*instants joint 3"],
        px: Float[np.ndarray, "*#instants joint 2"],
        confidence: Float[np.ndarray, "*#instants joint"],
    ) -> Float[np.ndarray, "*instants joint"]:
        """By how much one camera sees each joint beside where it is; NaN where that is not known."""
        beside = (self._rig.cameras[c].project(positions_m) - px) / self._focal_px[c]
        return np.where(confidence > 0, 1e3 * np.linalg.norm(beside, axis=-1), np.nan)

    def _lag(self, c: int, allowed_s: float) -> _Lag | None:
        """None: it cannot be told."""
        parts = [self._of_person(c, list(path)) for path in self._paths.values() if len(path) >= 2]
        if not parts:
            return None
        mrad, left_mrad = (np.concatenate(arrays, axis=-1) for arrays in zip(*parts, strict=True))
        both = np.isfinite(mrad) & np.isfinite(mrad[_NOW])
        enough = both.sum(axis=1) >= _FEWEST
        if not enough.any():
            return None
        of_lag = np.where(enough, _mean(mrad, both), np.inf)
        of_now = _mean(np.broadcast_to(mrad[_NOW], mrad.shape), both)
        left = _mean(np.broadcast_to(left_mrad, mrad.shape), both)
        best = int(np.argmin(of_lag / np.maximum(of_now, MAX_MRAD)))
        # A minimum, from which the images agree less and less to both sides: of who stood, many lags are right.
        as_good = np.flatnonzero(of_lag <= _NOT_BETTER * of_lag[best])
        is_minimum = 0 < best < len(_LAGS_S) - 1 and np.isfinite(of_lag[[best - 1, best + 1]]).all()
        is_minimum = is_minimum and float(np.ptp(_LAGS_S[as_good])) <= _KNOWN_TO_S
        is_better = of_now[best] > MAX_MRAD and max(of_lag[best], left[best]) < _LEFT * of_now[best]
        if is_minimum and is_better and abs(_LAGS_S[best]) > allowed_s:
            return _Lag(float(_LAGS_S[best]), float(of_lag[best] + left[best]))
        moved = enough & (np.abs(_LAGS_S) > allowed_s)
        is_right = moved.any() and (of_now[moved] < _LEFT * of_lag[moved]).all()
        return _Lag(0.0, 0.0) if is_right else None

    def _of_person(
        self, c: int, path: Sequence[_Look]
    ) -> tuple[Float[np.ndarray, "lag image"], Float[np.ndarray, " image"]]:
        """By how much beside their path every image of a camera sees somebody at every lag, where all of that is of the
        newest seconds, and by how much the others disagree."""
        at_s = np.array([look.at_s for look in path])
        positions_m = np.array([look.without_m[c] for look in path])
        wanted_s = at_s + _LAGS_S[:, None]
        before = np.clip(np.searchsorted(at_s, wanted_s, side="right") - 1, 0, len(at_s) - 2)
        share = ((wanted_s - at_s[before]) / np.diff(at_s)[before])[..., None, None]
        there_m = (1 - share) * positions_m[before] + share * positions_m[before + 1]
        px, confidence = np.array([look.px[c] for look in path]), np.array([look.confidence[c] for look in path])
        mrad = lower_medians(self._beside_mrad(c, there_m, px, confidence))
        is_known = (wanted_s >= at_s[0]) & (wanted_s <= at_s[-1])
        is_new = np.maximum(wanted_s, at_s) >= at_s[-1] - _NEWEST_S
        return np.where(is_known & is_new, mrad, np.nan), np.array([look.left_mrad[c] for look in path])


@dataclass(frozen=True, eq=False)
class _Look:
    """Somebody at one instant."""

    at_s: float
    px: Float[np.ndarray, "camera joint 2"]
    confidence: Float[np.ndarray, "camera joint"]
    without_m: Float[np.ndarray, "camera joint 3"]
    """Where the others of each camera see them."""
    left_mrad: Float[np.ndarray, " camera"]
    """By how much these disagree."""


@dataclass(frozen=True)
class _Lag:
    """What the images of a camera tell."""

    lag_s: float
    """Zero if somebody who moves is seen where they are."""
    left_mrad: float
    """By how much all cameras disagree with it."""


def _mean(values: Float[np.ndarray, "lag image"], known: Bool[np.ndarray, "lag image"]) -> Float[np.ndarray, " lag"]:
    return np.where(known, np.nan_to_num(values), 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)


def in_words(lag_s: float, others: Sequence[str]) -> str:
    """What is said of a camera whose images are so much later than their times, or of others, by name, in its place."""
    or_another = f" (or it is {' or '.join(others)}: it cannot be told which)" if others else ""
    return (
        f"it sees people where they {'will be in' if lag_s > 0 else 'were'} {abs(lag_s):.1f} s"
        f"{'' if lag_s > 0 else ' ago'}{or_another}: are its clock and its latency right? "
        f"[{Code.LATE_CAMERA}]"
    )
