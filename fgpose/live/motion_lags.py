"""Clocks that are wrong by so much that the tracker does not find people where they are in the image: seen at once."""

from __future__ import annotations

from collections import deque

import numpy as np
from jaxtyping import Float

from fgpose.calibration.disagreement import MAX_MRAD
from fgpose.finding import Code
from fgpose.geometry.camera import Camera, CameraRig
from fgpose.live.common_sightings import CommonSighting

# Looks four times a second: what is wrong is said within two seconds.
EVERY_S = 0.25
_REMEMBERED_S = 2.5
_FEWEST = 4
_LAGS_S = np.arange(-15, 16) * 0.1
# What is less may come from a camera that was moved a little, or from how a network sees somebody who turns.
_LEAST_S = 0.3
_SIGMAS = 3.0
# With the lag images must agree so much better with where people were: else it is no clock.
_LEFT = 0.4


class MotionLags:
    """Whether a camera sees people where they were some time ago, or where they will be.

    What was said stays until people who move are seen where they are.

    Args:
        rig: the cameras.
    """

    def __init__(self, rig: CameraRig) -> None:
        self._rig = rig
        self._paths: dict[int, deque[CommonSighting]] = {}
        self.faults: dict[str, str] = {}
        """By camera, in words."""

    def add(self, sighting: CommonSighting, sigma_s: Float[np.ndarray, " camera"]) -> None:
        """Somebody as all cameras see them, and what is not known of the clocks (standard deviations)."""
        path = self._paths.setdefault(sighting.person, deque())
        if path and not sighting.time_s > path[-1].time_s:
            return  # the tracker knows nothing new of them
        path.append(sighting)
        oldest_s = sighting.time_s - _REMEMBERED_S
        while path[0].time_s < oldest_s:
            path.popleft()
        self._paths = {person: each for person, each in self._paths.items() if each[-1].time_s > oldest_s}
        for c, camera in enumerate(self._rig.cameras):
            lag_s = _lag_s(path, c, camera, max(_LEAST_S, _SIGMAS * float(sigma_s[c])))
            if lag_s == 0:
                self.faults.pop(camera.name, None)
            elif lag_s is not None:
                self.faults.setdefault(camera.name, _in_words(lag_s))


def _lag_s(path: deque[CommonSighting], c: int, camera: Camera, allowed_s: float) -> float | None:
    """Zero if somebody who moves is seen where they are; None: it cannot be told."""
    at_s = np.array([each.time_s for each in path])
    seen = [each for each in path if (each.confidence[c] > 0).any()]
    if len(seen) < _FEWEST:
        return None
    # By how much beside, of every image (column) at every lag (row).
    positions_m = np.array([each.positions_m for each in path])
    instants_s = np.array([each.instant_s for each in seen])
    wanted_s = instants_s + _LAGS_S[:, None]
    before = np.clip(np.searchsorted(at_s, wanted_s, side="right") - 1, 0, len(at_s) - 2)
    share = ((wanted_s - at_s[before]) / np.diff(at_s)[before])[..., None, None]
    there_m = (1 - share) * positions_m[before] + share * positions_m[before + 1]
    observed_px = np.array([each.undistorted_px[c] for each in seen])
    confidence = np.array([each.confidence[c] for each in seen])
    beside = (camera.project(there_m) - observed_px) / np.diag(camera.K)[:2]
    mrad = np.where(confidence > 0, 1e3 * np.linalg.norm(beside, axis=-1), np.nan)
    inside = (wanted_s >= at_s[0]) & (wanted_s <= at_s[-1])
    each_mrad = np.where(inside, _median(mrad), np.nan)
    now = len(_LAGS_S) // 2
    both = np.isfinite(each_mrad) & np.isfinite(each_mrad[now])
    enough = both.sum(axis=1) >= _FEWEST
    if not enough.any():
        return None
    of_lag = np.where(enough, _mean(each_mrad, both), np.inf)
    of_now = _mean(np.broadcast_to(each_mrad[now], each_mrad.shape), both)
    best = int(np.argmin(of_lag / np.maximum(of_now, MAX_MRAD)))
    # A minimum, from which the images agree less and less to both sides.
    is_minimum = 0 < best < len(_LAGS_S) - 1 and np.isfinite(of_lag[[best - 1, best + 1]]).all()
    if (
        is_minimum
        and of_lag[best] < _LEFT * of_now[best]
        and of_now[best] > MAX_MRAD
        and abs(_LAGS_S[best]) > allowed_s
    ):
        return float(_LAGS_S[best])
    moved = enough & (np.abs(_LAGS_S) > allowed_s)
    is_right = moved.any() and (of_now[moved] < _LEFT * of_lag[moved]).all()
    return 0.0 if is_right else None


def _mean(values: Float[np.ndarray, "lag image"], known: np.ndarray) -> Float[np.ndarray, " lag"]:
    return np.where(known, np.nan_to_num(values), 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)


def _median(values: Float[np.ndarray, "*shape joint"]) -> Float[np.ndarray, "*shape"]:
    """Of what is known; NaN where nothing is."""
    in_order, n_known = np.sort(values, axis=-1), np.isfinite(values).sum(axis=-1)
    return np.take_along_axis(in_order, np.maximum(n_known - 1, 0)[..., None] // 2, axis=-1)[..., 0]


def _in_words(lag_s: float) -> str:
    return (
        f"it sees people where they {'will be in' if lag_s > 0 else 'were'} {abs(lag_s):.1f} s"
        f"{'' if lag_s > 0 else ' ago'}: are its clock and its latency right? "
        f"[{Code.LATE_CAMERA}]"
    )
