"""iSAM2 over a sliding window of frames, eliminated in the order of time.

GTSAM's IncrementalFixedLagSmoother marginalises the oldest variables by eliminating everything from them to the newest
again, so that every update costs the whole window. Here every elimination runs in the order of time: the oldest frame
is then always a leaf of the Bayes tree, its marginal is already there, and an update touches only the newest frames and
what has moved far enough to be linearised again. Measured on 17 joints, 4 cameras and a window of 25 frames: 2.4 ms
(median) and 3.7 ms (99th percentile) instead of 3.4 ms and 25 ms.

Why the tree cannot be out of order. ISAM2::marginalizeLeaves does not check what it is given: whatever depends on the
variables it removes must be removed with them, or the process dies. In the Bayes net of the tree that is so for the
oldest frame if no variable is conditioned on one of an EARLIER frame (*). An update eliminates a set of variables anew
and keeps the conditionals of all others, so (*) survives it if that set is eliminated in the order of time. GTSAM's
ordering (constrained COLAMD) puts groups of variables one after the other, in the order of their labels, provided that
every label is less than the number n of variables in the set; and at least the new variables are in it. Hence, with one
label a frame from the oldest on: if there are no more frames than new variables, all labels are valid. Otherwise the
set is asked for beforehand (predictUpdateInfo), and only its frames are labelled: they are no more than its variables.
Where GTSAM would then eliminate the whole tree, the whole window is that set. Marginalising and splitting a clique
leave all other conditionals as they are.
"""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Iterable, Sequence
from functools import cache

import gtsam
import numpy as np
from jaxtyping import Float
from threadpoolctl import ThreadpoolController

_NEVER_RELINEARIZE = 1e6  # velocities enter linearly
# Of the priors after a repair, metres and m/s. The repair keeps the estimates and loses their information. So loose
# that new detections (about 1 cm) dominate.
_REPAIRED_SIGMA = 0.1
# What GTSAM's exceptions become in Python; LinAlgError of numpy is a ValueError.
_FAILURES = (RuntimeError, IndexError, ValueError)


class FixedLagSmoother:
    """The variables of the newest frames; older ones live on as a prior on the oldest frame that is left.

    It does not fail: where GTSAM does (a system that is singular in double precision), the window is rebuilt from its
    own estimates.

    Args:
        relinearize_m: a position is linearised again when it moves by more than this.
    """

    repairs: int
    """How often the window was rebuilt."""

    def __init__(self, relinearize_m: float) -> None:
        self._params = gtsam.ISAM2Params()
        self._params.findUnusedFactorSlots = True  # or memory and time grow without end
        self._params.relinearizeSkip = 1
        thresholds = gtsam.ISAM2ThresholdMap()
        thresholds.insert(("x", np.full(3, relinearize_m)))
        thresholds.insert(("v", np.full(3, _NEVER_RELINEARIZE)))
        self._params.setRelinearizeThreshold(thresholds)
        self._isam = gtsam.ISAM2(self._params)
        self._frames: deque[list[int]] = deque()
        self._estimates: dict[int, np.ndarray] = {}
        self._labels = _Labels()
        self.repairs = 0

    def add(self, factors: gtsam.NonlinearFactorGraph, values: gtsam.Values, keys: Sequence[int]) -> None:
        """Take a new frame with its variables; a frame without any is fine.

        Args:
            factors: they join variables of this frame and of the one before only.
            values: finite first guesses of exactly these keys.
        """
        self._frames.append(list(keys))
        if not keys:
            return
        self._estimates.update((key, values.atPoint3(key)) for key in keys)
        try:
            self._isam.update(factors, values, self._in_order(factors, values, len(keys)))
        except _FAILURES:
            self._repair()

    def drop_oldest(self) -> None:
        """Marginalise the oldest frame: its information stays as a prior on the next one."""
        oldest = self._frames.popleft()
        if not oldest:
            return
        self._labels.remove(oldest)
        for key in oldest:
            del self._estimates[key]
        try:
            self._isam.marginalizeLeaves(_key_list(oldest))
        except _FAILURES:
            self._repair()

    def points(self, keys: Sequence[int]) -> Float[np.ndarray, "key 3"]:
        """Current estimates of positions or velocities of frames in the window."""
        if not keys:
            return np.zeros((0, 3))
        try:
            points = np.array([self._isam.calculateEstimatePoint3(key) for key in keys])
            if not np.isfinite(points).all():
                raise RuntimeError("a system without a solution")
        except _FAILURES:
            self._repair()
            return np.array([self._estimates[key] for key in keys])
        self._estimates.update(zip(keys, points, strict=True))
        return points

    def covariances(self, keys: Sequence[int]) -> Float[np.ndarray, "key 3 3"]:
        """Marginal covariance of each of these positions."""
        if not keys:
            return np.zeros((0, 3, 3))
        try:
            return self._marginals(keys)
        except _FAILURES:
            self._repair()
            return self._marginals(keys)

    def _marginals(self, keys: Sequence[int]) -> Float[np.ndarray, "key 3 3"]:
        """Raises a ValueError where one is not positive definite."""
        joint = self._isam.jointMarginalCovariance(list(keys))
        covariances = np.stack([joint.at(key, key) for key in keys])
        np.linalg.cholesky(covariances)
        return covariances

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
        except _FAILURES:  # indeterminate in double precision
            return np.full((len(keys), 3, 3), np.nan)
        rows = [slice(3 * at, 3 * at + 3) for at in (frames[0].index(key) for key in keys)]
        return np.stack([covariance[row, row] for row in rows])

    def _in_order(
        self, factors: gtsam.NonlinearFactorGraph, values: gtsam.Values, n_new: int
    ) -> gtsam.ISAM2UpdateParams:
        """Have everything that the update eliminates eliminated in the order of time; see the head of this file."""
        params = gtsam.ISAM2UpdateParams()
        frames = [frame for frame in self._frames if frame]
        if len(frames) <= n_new:
            params.constrainedKeys = self._labels.of(frames, n_new)
            return params
        eliminated, may_be_all = self._isam.predictUpdateInfo(factors, values, params)
        if may_be_all:
            params.extraReelimKeys = _key_list(itertools.chain.from_iterable(frames))
        else:
            frames = _frames_of(eliminated, frames)
        params.constrainedKeys = _Labels().of(frames, len(frames))
        return params

    def _repair(self) -> None:
        """Start again with a prior on every variable of the window, around its last estimate: that cannot fail."""
        self.repairs += 1
        factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        noise = gtsam.noiseModel.Isotropic.Sigma(3, _REPAIRED_SIGMA)
        for key, estimate in self._estimates.items():
            factors.add(gtsam.PriorFactorPoint3(key, estimate, noise))
            values.insert(key, estimate)
        self._isam = gtsam.ISAM2(self._params)
        self._isam.update(factors, values)


class _Labels:
    """Numbers of frames, increasing with time, by key. Kept from update to update: to make them anew takes as long as
    marginalising."""

    def __init__(self) -> None:
        self._map = gtsam.KeyGroupMap()
        self._newest: list[int] = []
        self._n_used = 0

    def of(self, frames: list[list[int]], limit: int) -> gtsam.KeyGroupMap:
        """Labels below the limit, which is no less than the number of frames."""
        grown_by_one = len(frames) > 1 and frames[-2] is self._newest
        if not grown_by_one or self._n_used >= limit:
            self._map.clear()
            self._n_used = 0
        for frame in frames[-1:] if self._n_used else frames:
            for key in frame:
                self._map.insert2(key, self._n_used)
            self._n_used += 1
        self._newest = frames[-1]
        return self._map

    def remove(self, keys: list[int]) -> None:
        for key in keys:
            self._map.erase(key)


def _frames_of(keys: gtsam.KeySet, frames: list[list[int]]) -> list[list[int]]:
    """These keys by their frames, oldest first; hardly ever are they of other frames than the newest."""
    found: deque[list[int]] = deque()
    missing = len(keys)
    for frame in reversed(frames):
        if not missing:
            break
        own = [key for key in frame if key in keys]
        missing -= len(own)
        if own:
            found.appendleft(own)
    return list(found)


def _key_list(keys: Iterable[int]) -> gtsam.KeyList:
    key_list = gtsam.KeyList()
    for key in keys:
        key_list.push_back(key)
    return key_list


def _ordering(keys: Iterable[int]) -> gtsam.Ordering:
    ordering = gtsam.Ordering()
    for key in keys:
        ordering.push_back(key)
    return ordering


@cache
def _blas() -> ThreadpoolController:
    """Matrices of 100 x 100 are too small to share between cores: threads that wait for each other take longer."""
    return ThreadpoolController()
