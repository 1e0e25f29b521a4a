"""Bone lengths: left equals right, and constant over time, without knowing the length."""

from __future__ import annotations

import gtsam
import numpy as np
from jaxtyping import Float

from fgpose_factors.custom import custom_factor

_Points = Float[np.ndarray, "*bones 3"]
_Residuals = Float[np.ndarray, "*bones 1"]
_ByPoint = Float[np.ndarray, "*bones 1 3"]
_ByLength = Float[np.ndarray, "*bones 1 1"]


def bone_length_and_direction(start_m: _Points, end_m: _Points) -> tuple[Float[np.ndarray, "*bones"], _Points]:
    """Distance of two points in metres and its gradient by the end point: the unit direction, zero at distance zero."""
    difference = end_m - start_m
    length = np.sqrt(np.einsum("...i,...i->...", difference, difference))[..., None]
    # At length zero the distance has a kink and any direction is a subgradient. Zero lets other factors decide.
    direction = np.divide(difference, length, out=np.zeros_like(difference), where=length > 1e-9)
    return length[..., 0], direction


def symmetric_length_residual(
    left_start_m: _Points, left_end_m: _Points, right_start_m: _Points, right_end_m: _Points
) -> tuple[_Residuals, tuple[_ByPoint, _ByPoint, _ByPoint, _ByPoint]]:
    """|left| - |right| of one frame (eq. 4 of the paper), metres, and its Jacobians by the four points.

    The points of a pair of bones are in one frame of reference.
    """
    left_m, left = bone_length_and_direction(left_start_m, left_end_m)
    right_m, right = bone_length_and_direction(right_start_m, right_end_m)
    left, right = left[..., None, :], right[..., None, :]
    return (left_m - right_m)[..., None], (-left, left, right, -right)


def shared_length_residual(
    start_m: _Points, end_m: _Points, length_m: float | Float[np.ndarray, "*#bones"]
) -> tuple[_Residuals, tuple[_ByPoint, _ByPoint, _ByLength]]:
    """|end - start| - length, metres, and its Jacobians by the two points and the length.

    Args:
        start_m, end_m: in one frame of reference.
        length_m: the unknown length that mirrored bones share at all times.
    """
    distance_m, direction = bone_length_and_direction(start_m, end_m)
    residual_m, direction = (distance_m - length_m)[..., None], direction[..., None, :]
    return residual_m, (-direction, direction, np.full((*residual_m.shape, 1), -1.0))


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
