"""Less weight for detections of a joint that have not fitted for a while: they are probably hallucinated.

A robust kernel judges every detection by itself. But a network hallucinates an occluded joint for as long as the
occluder stays: the errors of the detections before and after tell more about a detection than its own error does.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from fgpose.config import ProjectionConfig

_POWER = 4
"""How sharply the weight falls with the error over the threshold."""

# Chosen on the tuning clips of the benchmark. Lower, cameras whose clocks are off lose weight that they need; higher, a
# moved camera keeps too much (mean error at 1, 2 and 2.5: desync_3 18.4, 18.1, 17.8 mm; bumped 18.7, 19.5, 21.2 mm).
_USUAL_ERRORS = 2.0

_MAX_VALUES = 32
"""The median takes at most so many detections, spread evenly: enough for a median, and bounds the memory."""


def persistence_weights(
    error_px: Float[np.ndarray, "frame camera joint"], time_s: Float[np.ndarray, " frame"], config: ProjectionConfig
) -> Float[np.ndarray, "frame camera joint"]:
    """Weight in (0, 1] of each detection: 1/2 where the median error of the detections of the same joint in the same
    camera, within memory_s before and after, is persistent_px.

    The threshold is at least twice the median error of the whole recording: where the clocks are off or the detector
    is less exact, all errors are large, which is no sign of occlusion. A camera that is worse than the others, because
    it has moved, does lose weight.

    Args:
        error_px: reprojection errors; NaN without a detection.
        time_s: of the frames, increasing.
    """
    lasting_px = _running_median(error_px, time_s, config.memory_s)
    usual_px = _median_known(lasting_px.reshape(-1, 1))
    return _weight(lasting_px, np.fmax(config.persistent_px, _USUAL_ERRORS * usual_px))


class RunningPersistence:
    """The same frame by frame, with a running mean of the errors in which older detections have less weight.

    Without the frames that follow, an occlusion is detected while it lasts. So the weights are for the next frame.
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

    def trust(self, seen: Bool[np.ndarray, "camera joint"]) -> Float[np.ndarray, "camera joint"]:
        """Share of its weight, in (0, 1], that each detection of the next frame should have.

        The threshold is twice persistent_px, for the newest pose errs too, and at least twice the error of the second
        best camera that sees the joint: it takes two to locate it. Where fewer fit, the estimate is as likely to be
        wrong as the detections; without weight they could never correct it. And where all clocks are off, all cameras
        err.

        Args:
            seen: which joints each camera detects in the next frame; where fewer than two do, trust is 1.
        """
        if len(seen) < 2:
            return np.ones(seen.shape)
        second_px = np.sort(np.where(seen, np.nan_to_num(self._error_px), np.inf), axis=0)[1]
        return _weight(self._error_px, _USUAL_ERRORS * np.maximum(self._config.persistent_px, second_px))


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
