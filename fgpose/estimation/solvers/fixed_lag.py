"""iSAM2 over a sliding window of frames, ordered in time.

GTSAM's IncrementalFixedLagSmoother lets go of the oldest variables by eliminating everything from them to the newest
again, so that every update costs the whole window. Here the elimination order is kept temporal instead: the oldest
frame is then always a leaf of the Bayes tree and is let go of for nothing, and an update touches only the newest
frames and what has moved far enough to be linearised again. Measured on 17 joints, 4 cameras and a window of 25 frames:
2.4 ms (median) and 3.7 ms (99th percentile) instead of 3.4 ms and 25 ms.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from functools import cache

import gtsam
import numpy as np
from jaxtyping import Float
from threadpoolctl import ThreadpoolController

_NEVER_RELINEARIZE = 1e6  # velocities enter linearly


class FixedLagSmoother:
    """The variables of the newest frames; older ones live on as a prior on the oldest frame that is left.

    Args:
        relinearize_m: a position is linearised again when it moves by more than this.
    """

    def __init__(self, relinearize_m: float) -> None:
        params = gtsam.ISAM2Params()
        params.findUnusedFactorSlots = True  # or memory and time grow without end
        params.relinearizeSkip = 1
        thresholds = gtsam.ISAM2ThresholdMap()
        thresholds.insert(("x", np.full(3, relinearize_m)))
        thresholds.insert(("v", np.full(3, _NEVER_RELINEARIZE)))
        params.setRelinearizeThreshold(thresholds)
        self._isam = gtsam.ISAM2(params)
        self._frames: deque[list[int]] = deque()
        self._ordered = True

    def add(self, factors: gtsam.NonlinearFactorGraph, values: gtsam.Values, keys: Sequence[int]) -> None:
        """Take a new frame with its variables; a frame without any is fine."""
        self._frames.append(list(keys))
        if not keys:
            return
        params = gtsam.ISAM2UpdateParams()
        # An ordering of n variables takes labels below n, and only the new variables are sure to be in it.
        labelled = len(keys)
        params.constrainedKeys = self._labels(labelled)
        result = self._isam.update(factors, values, params)
        in_order = sum(len(frame) for frame in self._newest(labelled))
        self._ordered &= result.getVariablesReeliminated() <= in_order

    def drop_oldest(self) -> None:
        """Marginalise the oldest frame: what is known of it stays as a prior on the next."""
        if not self._ordered:
            self._restore_order()
        oldest = gtsam.KeyList()
        for key in self._frames.popleft():
            oldest.push_back(key)
        if oldest.size():
            self._isam.marginalizeLeaves(oldest)

    def point(self, key: int) -> Float[np.ndarray, 3]:
        """Current estimate of a position or velocity of a frame in the window."""
        return self._isam.calculateEstimatePoint3(key)

    def covariances(self, keys: Sequence[int]) -> Float[np.ndarray, "key 3 3"]:
        """Marginal covariance of each of these positions."""
        if not keys:
            return np.zeros((0, 3, 3))
        joint = self._isam.jointMarginalCovariance(list(keys))
        return np.stack([joint.at(key, key) for key in keys])

    def oldest_covariances(self, keys: Sequence[int]) -> Float[np.ndarray, "key 3 3"]:
        """Marginal covariance of each of these positions of the oldest frame; NaN where the window does not give it.

        The way from the oldest frame to the root leads through all others: in the Bayes tree it costs ten to fifteen
        updates. To eliminate the window once more, from the newest frame to the oldest, costs one or two.
        """
        if not keys:
            return np.zeros((0, 3, 3))
        frames = [frame for frame in self._frames if frame]
        newest_first = _ordering(key for frame in reversed(frames[1:]) for key in frame)
        window = self._isam.getFactorsUnsafe().linearize(self._isam.getLinearizationPoint())
        try:
            oldest = window.eliminatePartialMultifrontal(newest_first)[1] if len(frames) > 1 else window
            information, _ = oldest.hessian(_ordering(frames[0]))
            with _blas().limit(limits=1, user_api="blas"):
                covariance = np.linalg.inv(information)
        except (RuntimeError, np.linalg.LinAlgError):  # indeterminate in double precision
            return np.full((len(keys), 3, 3), np.nan)
        rows = [slice(3 * at, 3 * at + 3) for at in (frames[0].index(key) for key in keys)]
        return np.stack([covariance[row, row] for row in rows])

    def _labels(self, count: int) -> gtsam.KeyGroupMap:
        """The newest frames last, one after the other, with labels below count; all older ones first."""
        labels = gtsam.KeyGroupMap()
        for label, frame in zip(range(count - 1, 0, -1), self._newest(count), strict=False):
            for key in frame:
                labels.insert2(key, label)
        return labels

    def _newest(self, count: int) -> list[list[int]]:
        """The newest frames that have variables, newest first."""
        return [frame for frame in reversed(self._frames) if frame][:count]

    def _restore_order(self) -> None:
        """Eliminate the whole window in temporal order again: a relinearisation went beyond the labelled frames."""
        params = gtsam.ISAM2UpdateParams()
        params.constrainedKeys = self._labels(sum(map(bool, self._frames)))
        everything = gtsam.KeyList()
        for key in (key for frame in self._frames for key in frame):
            everything.push_back(key)
        params.extraReelimKeys = everything
        self._isam.update(gtsam.NonlinearFactorGraph(), gtsam.Values(), params)
        self._ordered = True


def _ordering(keys: Iterable[int]) -> gtsam.Ordering:
    ordering = gtsam.Ordering()
    for key in keys:
        ordering.push_back(key)
    return ordering


@cache
def _blas() -> ThreadpoolController:
    """Matrices of 100 x 100 are too small to share between cores: threads that wait for each other take longer."""
    return ThreadpoolController()
