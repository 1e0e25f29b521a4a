"""How large the errors of visible detections are in each camera, online: what spread tells of a recording, frame by
frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from fgpose.estimation.noise import CORRELATION_S, LEAST_SPREAD_M, MEMORY_S, SAME_S, share_believed
from fgpose.estimation.visibility.detection_residuals import DetectionResiduals
from fgpose.estimation.visibility.spread import PRIOR_MEASUREMENTS_OF_CAMERA
from fgpose.estimation.visibility.visibility import independent
from fgpose_factors.robust_statistics import weighted_median

# It follows a camera that is moved within some seconds.
_MEMORY_S = 10.0
# 1 / (2 f), with the density f of the logarithm of the length of a normal error at its median, ln 2.
_MEDIAN_GAIN = 0.72
_MOST_STRETCHES = int(MEMORY_S / SAME_S)


@dataclass(frozen=True, eq=False)
class RunningSpread:
    """Usual errors of the last seconds, and how large those of the last half second are in them."""

    usual_m: Float[np.ndarray, "measure camera"]
    """By both measures of DetectionResiduals, of which the smaller holds."""
    measurements: Float[np.ndarray, "measure camera"]
    """From which they were learned, as far as they count still."""
    lately: tuple[tuple[float, Float[np.ndarray, "2 _"]], ...] = ()
    """Time of each frame of the last SAME_S, and what its detections alone say for the spread, with their weights."""
    stretches: tuple[tuple[float, float, float], ...] = ()
    """End of each earlier stretch of SAME_S, the logarithm of the median of what it says, and how much counts there."""

    @staticmethod
    def at_first(prior_m: float, n_cameras: int) -> RunningSpread:
        """Before there is any frame."""
        return RunningSpread(np.full((2, n_cameras), prior_m), np.zeros((2, n_cameras)))

    @cached_property
    def spread_m(self) -> Float[np.ndarray, " camera"]:
        """Standard deviation of the visible detections of each camera, along each axis of the image, at the joint."""
        return self._size * self.usual_m.min(axis=0)

    @cached_property
    def _size(self) -> float:
        """Of the errors lately, in the usual ones; believed as far as stretches differ by more than by chance."""
        if not self.stretches or not (newest := _log_median(self.lately))[1]:
            return 1.0
        logs, of_all = np.array([stretch[1:] for stretch in self.stretches] + [newest]).T
        return float(np.exp(share_believed(2 * logs, of_all)[-1] * (logs[-1] - np.log(self.usual_m[1]).mean())))

    def then(
        self,
        time_s: float,
        since_s: Float[np.ndarray, "camera 1"],
        residuals: DetectionResiduals,
        has_image: Bool[np.ndarray, " camera"],
    ) -> RunningSpread:
        """With the next frame.

        Args:
            time_s: of the frame.
            since_s: time since the last image of each camera.
            residuals: of the frame.
            has_image: which cameras have one.
        """
        tells, single_m = residuals.tells[:, 0] & has_image[:, None], residuals.single_spread_m[:, 0]
        followed = self._followed(tells, single_m, since_s, residuals, has_image)
        return followed._lasted(time_s, np.stack([single_m[1], residuals.weights[0]])[:, tells[1]])

    def _followed(
        self,
        tells: Bool[np.ndarray, "measure camera joint"],
        single_m: Float[np.ndarray, "measure camera joint"],
        since_s: Float[np.ndarray, "camera 1"],
        residuals: DetectionResiduals,
        has_image: Bool[np.ndarray, " camera"],
    ) -> RunningSpread:
        """Robbins and Monro's estimate of the weighted median that the batch takes."""
        told = np.where(tells, independent(since_s, CORRELATION_S) * residuals.weights[0], 0.0)
        keep = np.where(has_image, np.exp(-since_s[:, 0] / _MEMORY_S), 1.0)
        measurements = keep * self.measurements + told.sum(axis=-1)
        larger = np.sum(told * np.sign(single_m - self.usual_m[..., None]), axis=-1, where=tells)
        logs = _MEDIAN_GAIN * larger / (PRIOR_MEASUREMENTS_OF_CAMERA + measurements)
        return replace(self, usual_m=np.maximum(self.usual_m * np.exp(logs), LEAST_SPREAD_M), measurements=measurements)

    def _lasted(self, time_s: float, told_m: Float[np.ndarray, "2 _"]) -> RunningSpread:
        """Nothing of the last frame but its usual errors goes into a stretch: another image may join it."""
        stretches, before = self.stretches, [frame for frame in self.lately if frame[0] < time_s]
        ended_s = stretches[-1][0] if stretches else before[0][0] if before else time_s
        if time_s - ended_s >= SAME_S and (told := _log_median(before))[1]:
            stretches = (*stretches, (time_s, *told))[-_MOST_STRETCHES:]
        lately = (*(frame for frame in before if frame[0] > time_s - SAME_S), (time_s, told_m))
        return replace(self, lately=lately, stretches=stretches)


def _log_median(frames: Sequence[tuple[float, Float[np.ndarray, "2 _"]]]) -> tuple[float, float]:
    """And of how much; of nothing where nobody is seen."""
    single_m, weights = np.concatenate([told_m for _, told_m in frames], axis=1)
    if not weights.any():
        return 0.0, 0.0
    return float(np.log(max(weighted_median(single_m, weights), LEAST_SPREAD_M))), float(weights.sum())
