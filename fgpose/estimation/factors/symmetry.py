"""Symmetry: left limbs are as long as right ones in this frame (eq. 4)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np

from fgpose.estimation.factors.joint_rows import JointRows
from fgpose.estimation.segment import Segment
from fgpose_factors import noise_model, symmetric_bone_length_factor, symmetric_length_residual


@dataclass(frozen=True, eq=False)
class Symmetries(JointRows):
    """Start and end of the left bone, start and end of the right one."""

    @classmethod
    def of(cls, segment: Segment) -> Iterator[Symmetries]:
        """The limb pairs whose joints are all estimated in some frame."""
        if segment.config.symmetry.form != "frame":
            return
        pairs = np.array([(*left, *right) for left, right in segment.skeleton.limb_pairs], dtype=int).reshape(-1, 4)
        present = np.asarray(segment.active[:, pairs].all(axis=-1))
        used = np.asarray(present.any(axis=0))
        if used.any():
            sigma_m = np.full(used.sum(), segment.config.symmetry.sigma_m)
            yield cls(segment.slots[pairs[used]].T, present[:, used], sigma_m)

    def residual(
        self, points_m: Sequence[np.ndarray], lengths_m: np.ndarray
    ) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
        left_start_m, left_end_m, right_start_m, right_end_m = points_m
        return symmetric_length_residual(left_start_m, left_end_m, right_start_m, right_end_m)

    def factor(self, keys: Sequence[int], row: int) -> gtsam.NonlinearFactor:
        left_start, left_end, right_start, right_end = keys
        noise = noise_model(1, float(self.sigma_m[row]))
        return symmetric_bone_length_factor((left_start, left_end), (right_start, right_end), noise)
