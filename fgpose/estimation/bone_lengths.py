"""Bone lengths learned while a recording is running: from both sides, constant over time, without prior statistics."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from fgpose.estimation.noise import CORRELATION_S, correlated_frames
from fgpose.skeleton import Skeleton

_BIN_M = 1e-3  # well below the 5 mm by which a bone may vary (symmetry.sigma_m)
_MAX_LENGTH_M = 2.0  # no bone is longer; bounds the memory
# Half the interquartile range of a Gaussian, in sigmas.
_QUARTILE = 0.6745


class RunningLengths:
    """Running median of every shared bone length, and how well it is known, in constant memory.

    Each complete bone of each frame's first guess (triangulated or fused, not smoothed) is a sample, so that an
    initial error of the estimate cannot confirm itself. Samples are counted in bins of 1 mm.
    """

    def __init__(self, skeleton: Skeleton) -> None:
        self._skeleton = skeleton
        self._length_of_bone = np.array(skeleton.length_of_bone, dtype=int)
        self._counts = np.zeros((skeleton.n_lengths, int(_MAX_LENGTH_M / _BIN_M)), dtype=np.int64)
        self._independent = np.zeros(skeleton.n_lengths)

    def add(
        self, step_s: float, positions_m: Float[np.ndarray, "joint 3"], trusted: Bool[np.ndarray, " joint"]
    ) -> None:
        """Count the bones of one frame whose two joints are trusted.

        Args:
            step_s: time since the frame before; inf for the first one.
            positions_m: world frame; NaN where a joint is not known.
            trusted: whether to count a joint.
        """
        bones = np.array(self._skeleton.bones, dtype=int).reshape(-1, 2)
        lengths_m = self._skeleton.bone_lengths(positions_m)
        sampled = trusted[bones].all(axis=1) & (lengths_m < _MAX_LENGTH_M)
        lengths = self._length_of_bone[sampled]
        np.add.at(self._counts, (lengths, (lengths_m[sampled] / _BIN_M).astype(int)), 1)
        np.add.at(self._independent, lengths, 1 / correlated_frames(step_s, CORRELATION_S))

    def median_m(self) -> Float[np.ndarray, " length"]:
        """Median of the samples; NaN where there is none."""
        return self._quantile_m(0.5)

    def sigma_m(self) -> Float[np.ndarray, " length"]:
        """Standard deviation of the median: that of one sample (from the quartiles) by the root of the number
        of independent ones, for errors of detections are correlated in time."""
        spread_m = (self._quantile_m(0.75) - self._quantile_m(0.25)) / (2 * _QUARTILE) + _BIN_M
        return np.sqrt(np.pi / 2) * spread_m / np.sqrt(np.maximum(self._independent, 1.0))

    def _quantile_m(self, quantile: float) -> np.ndarray:
        cumulative = np.cumsum(self._counts, axis=1)
        total = cumulative[:, -1]
        bins = np.argmax(cumulative >= quantile * total[:, None], axis=1)
        return np.where(total > 0, (bins + 0.5) * _BIN_M, np.nan)
