"""Lengths of the body as shares of the stature.

Drillis and Contini, Body Segment Parameters, 1966, in Winter, Biomechanics and Motor Control of Human Movement,
fig. 4.1. Adults differ by some 5 % from these, and as much by where data sets have the joints.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from jaxtyping import Float

from fgpose.skeleton import Skeleton

UPPER_ARM, FOREARM, THIGH, SHANK = 0.186, 0.146, 0.245, 0.246
ANKLE_HEIGHT, HIP_HEIGHT, SHOULDER_HEIGHT = 0.039, 0.530, 0.818
TRUNK = SHOULDER_HEIGHT - HIP_HEIGHT
# Networks place hips and shoulders nearer to each other than the widths of the figure.
SHOULDERS, HIPS = 0.21, 0.13

# Of somebody who stands with hanging arms: how far from the middle, and how high.
_STANDING = {
    "pelvis": (0.0, HIP_HEIGHT),
    "spine": (0.0, HIP_HEIGHT + TRUNK / 2),
    "thorax": (0.0, SHOULDER_HEIGHT),
    "neck": (0.0, SHOULDER_HEIGHT),
    "shoulder": (SHOULDERS / 2, SHOULDER_HEIGHT),
    "elbow": (SHOULDERS / 2, SHOULDER_HEIGHT - UPPER_ARM),
    "wrist": (SHOULDERS / 2, SHOULDER_HEIGHT - UPPER_ARM - FOREARM),
    "hip": (HIPS / 2, HIP_HEIGHT),
    "knee": (HIPS / 2, HIP_HEIGHT - THIGH),
    "ankle": (HIPS / 2, HIP_HEIGHT - THIGH - SHANK),
}
_SIDES = {"left_": 1.0, "right_": -1.0}

# Of anybody's lengths: from a child of six years to a tall man (two standard deviations); proportions of people differ,
# and where data sets have the joints, by as much again, hips and the upper end of the trunk by some centimetres.
_STATURE_M, _SIZE, _PROPORTION, _PLACES_M = 1.65, 0.3, 0.15, 0.03


def shares_of_stature(skeleton: Skeleton) -> Float[np.ndarray, " length"]:
    """Of the lengths of a skeleton; NaN where the proportions do not tell: head, hands, feet, joints of other names."""
    places = np.array([standing(joint) for joint in skeleton.joints])
    shares = np.full(skeleton.n_lengths, np.nan)
    for (start, end), length in zip(skeleton.bones, skeleton.length_of_bone, strict=True):
        shares[length] = np.linalg.norm(places[start] - places[end])
    return shares


def usual_lengths(
    skeleton: Skeleton, guess_m: Float[np.ndarray, " length"], guess_sigma_m: float
) -> tuple[Float[np.ndarray, " length"], Float[np.ndarray, "length length"]]:
    """Mean and covariance of somebody's lengths before anything is measured: who has long legs has long arms.

    Args:
        skeleton: whose lengths.
        guess_m: where the proportions do not tell; it may be NaN.
        guess_sigma_m: its standard deviation.
    """
    mean_m = _STATURE_M * shares_of_stature(skeleton)
    is_told = np.isfinite(mean_m)
    of_size_m = np.where(is_told, _SIZE * mean_m, 0.0)
    own_m = np.where(is_told, np.hypot(_PROPORTION * mean_m, _PLACES_M), guess_sigma_m)
    return np.where(is_told, mean_m, guess_m), np.outer(of_size_m, of_size_m) + np.diag(own_m**2)


def standing(joint: str, others: Mapping[str, tuple[float, float]] = MappingProxyType({})) -> tuple[float, float]:
    """How far to the left of the middle a joint is of somebody who stands with hanging arms, and how high, as shares of
    the stature; NaN where that is not told.

    Args:
        joint: its name.
        others: the same of joints without left_ and right_ that the proportions do not tell.
    """
    side = next((side for side in _SIDES if joint.startswith(side)), "")
    across, height = {**others, **_STANDING}.get(joint.removeprefix(side), (np.nan, np.nan))
    return _SIDES.get(side, 1.0) * across, height
