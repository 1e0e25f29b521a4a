"""Bone lengths: left equals right, and constant over time, without knowing the length."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np

from fgpose_factors.custom import custom_factor


def bone_length_and_direction(start_m: np.ndarray, end_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance of two points and its gradient by the end point: the unit direction, zero for a bone of length zero.

    Args:
        start_m, end_m: (..., 3) each, metres.

    Returns:
        Distances (...) in metres and directions (..., 3).
    """
    difference = end_m - start_m
    length = np.sqrt(np.einsum("...i,...i->...", difference, difference))[..., None]
    # At length zero the distance has a kink and any direction is a subgradient. Zero lets other factors decide.
    direction = np.divide(difference, length, out=np.zeros_like(difference), where=length > 1e-9)
    return length[..., 0], direction


def symmetric_length_residual(
    left_start_m: np.ndarray, left_end_m: np.ndarray, right_start_m: np.ndarray, right_end_m: np.ndarray
) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
    """|left| - |right| of one frame (eq. 4 of the paper), metres.

    Args:
        left_start_m, left_end_m, right_start_m, right_end_m: (3,) each, in one frame of reference.

    Returns:
        Residual (1,) and four Jacobians (1, 3).
    """
    left_m, left = bone_length_and_direction(left_start_m, left_end_m)
    right_m, right = bone_length_and_direction(right_start_m, right_end_m)
    return np.array([left_m - right_m]), (-left[None], left[None], right[None], -right[None])


def shared_length_residual(
    start_m: np.ndarray, end_m: np.ndarray, length_m: float | np.ndarray
) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
    """|end - start| - length, metres.

    Args:
        start_m, end_m: (3,) each.
        length_m: the unknown length that mirrored bones share at all times.

    Returns:
        Residual (1,) and Jacobians (1, 3), (1, 3), (1, 1).
    """
    distance_m, direction = bone_length_and_direction(start_m, end_m)
    return np.array([distance_m - length_m]), (-direction[None], direction[None], -np.ones((1, 1)))


def symmetric_bone_length_factor(
    left: tuple[int, int], right: tuple[int, int], noise: gtsam.noiseModel.Base
) -> gtsam.CustomFactor:
    """Custom factor on four Point3: the left bone is as long as the right one. Noise: dimension 1, metres."""
    point = gtsam.Values.atPoint3
    return custom_factor((*left, *right), noise, symmetric_length_residual, (point,) * 4)


def shared_bone_length_factor(bone: tuple[int, int], length: int, noise: gtsam.noiseModel.Base) -> gtsam.CustomFactor:
    """Custom factor on two Point3 and one double: the bone has the shared length. Noise: dimension 1, metres."""
    point, scalar = gtsam.Values.atPoint3, gtsam.Values.atDouble
    return custom_factor((*bone, length), noise, shared_length_residual, (point, point, scalar))


@dataclass(frozen=True)
class BoneLengths:
    """Many shared-length factors, linearised at once.

    The same factor as shared_bone_length_factor, for a batch solver that linearises from Python: one numpy expression
    instead of one callback per bone and frame.
    """

    start_keys: Sequence[int]
    end_keys: Sequence[int]
    length_keys: Sequence[int]
    sigma_m: float
    """Standard deviation of each residual, metres."""

    def residuals_m(self, starts_m: np.ndarray, ends_m: np.ndarray, lengths_m: np.ndarray) -> np.ndarray:
        """(N,) residuals of all factors."""
        return np.linalg.norm(ends_m - starts_m, axis=1) - lengths_m

    def error(self, starts_m: np.ndarray, ends_m: np.ndarray, lengths_m: np.ndarray) -> float:
        """Half the sum of the squared whitened residuals, as NonlinearFactorGraph.error counts it."""
        return 0.5 * float(np.sum((self.residuals_m(starts_m, ends_m, lengths_m) / self.sigma_m) ** 2))

    def linearize_into(
        self, linear: gtsam.GaussianFactorGraph, starts_m: np.ndarray, ends_m: np.ndarray, lengths_m: np.ndarray
    ) -> None:
        """Append every factor, linearised at these (N, 3), (N, 3) and (N,) values."""
        distances_m, directions = bone_length_and_direction(starts_m, ends_m)
        right_hand_sides = (lengths_m - distances_m)[:, None]
        minus_one = -np.ones((1, 1))
        noise = gtsam.noiseModel.Isotropic.Sigma(1, self.sigma_m)
        rows = zip(
            self.start_keys,
            -directions[:, None],
            self.end_keys,
            directions[:, None],
            self.length_keys,
            right_hand_sides,
            strict=True,
        )
        for start, to_start, end, to_end, length, right_hand_side in rows:
            linear.add(gtsam.JacobianFactor(start, to_start, end, to_end, length, minus_one, right_hand_side, noise))
