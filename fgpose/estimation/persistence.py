"""Detections that have not fitted for a while: what an occluded joint's detections do, and those of a seen one do not.

A robust kernel judges every detection by itself. A network that cannot see a joint invents it, and its inventions are
wrong for as long as the occluder stays: the errors around a detection in time tell more about it than its own does.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.config import ProjectionConfig

_POWER = 4
"""How sharply the weight falls; gently enough that a detection just below the threshold counts nearly in full."""

_MAX_VALUES = 32
"""Of so many a median is as good as of all that a fast camera delivers, and fits into memory."""


def persistence_weights(
    error_px: Float[np.ndarray, "frame camera joint"], time_s: Float[np.ndarray, " frame"], config: ProjectionConfig
) -> Float[np.ndarray, "frame camera joint"]:
    """Weight in (0, 1] of each detection: 1/2 where the median error of the detections of the same joint in the same
    camera, within memory_s before and after, is persistent_px.

    A camera that is wrongly calibrated or late misses everything by something: its usual error is no sign of
    occlusion, so half of a camera's detections always count at least half.

    Args:
        error_px: reprojection errors; NaN without a detection.
        time_s: of the frames, increasing.
    """
    lasting_px = _running_median(error_px, time_s, config.memory_s)
    of_cameras = lasting_px.swapaxes(0, 1).reshape(lasting_px.shape[1], -1)
    threshold_px = np.fmax(config.persistent_px, _median_known(of_cameras.T))[:, None]
    return _weight(lasting_px, threshold_px)


class RunningPersistence:
    """The same frame by frame: the mean error of each detection's forerunners, older ones counting ever less.

    Without the frames that follow it is too late a sign to weigh detections by, but it tells how far the newest pose
    can be trusted.
    """

    def __init__(self, shape: tuple[int, int], config: ProjectionConfig) -> None:
        self._config = config
        self._error_px = np.full(shape, np.nan)

    def add(self, step_s: float, error_px: Float[np.ndarray, "camera joint"]) -> None:
        """Take the reprojection errors of a frame; NaN without a detection."""
        keep = np.exp(-step_s / self._config.memory_s)
        mean_px = np.where(np.isnan(self._error_px), error_px, keep * self._error_px + (1 - keep) * error_px)
        self._error_px = np.where(np.isnan(error_px), self._error_px, mean_px)

    def weights(self) -> Float[np.ndarray, "camera joint"]:
        """Weight in (0, 1] of each detection: 1/2 where the mean error is persistent_px."""
        return _weight(self._error_px, self._config.persistent_px)


def _weight(error_px: np.ndarray, threshold_px: float | np.ndarray) -> np.ndarray:
    return np.where(np.isnan(error_px), 1.0, 1.0 / (1.0 + (np.nan_to_num(error_px) / threshold_px) ** _POWER))


def _running_median(
    values: Float[np.ndarray, "frame camera joint"], time_s: Float[np.ndarray, " frame"], reach_s: float
) -> Float[np.ndarray, "frame camera joint"]:
    """Median of what is known up to reach_s before and after; NaN where nothing is.

    A frame stands for the time half way to its neighbours; what lies partly within reach counts.
    """
    between_s = (time_s[:-1] + time_s[1:]) / 2
    first = np.searchsorted(between_s, time_s - reach_s, side="left")
    count = np.searchsorted(between_s, time_s + reach_s, side="right") + 1 - first
    every = 1 + count // _MAX_VALUES
    offsets = np.arange(min(count.max(), _MAX_VALUES))[:, None] * every
    around = values[np.minimum(first + offsets, len(values) - 1)]
    around[offsets >= count] = np.nan
    return _median_known(around)


def _median_known(values: np.ndarray) -> np.ndarray:
    """Lower median over the first axis of what is not NaN. numpy.nanmedian takes twenty times as long."""
    ordered = np.sort(values, axis=0)  # NaN last
    middle = np.maximum(np.isfinite(values).sum(axis=0) - 1, 0) // 2
    return np.take_along_axis(ordered, middle[None], axis=0)[0]
