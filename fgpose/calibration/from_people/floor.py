"""The floor, from the feet that stand on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.calibration.from_people.anatomy import Anatomy
from fgpose.calibration.from_people.steps import Steps

# Of the heights of a standing foot, least standard deviation as a share of the stature: 10 mm, as of the vertical.
_FOOT_SIGMA = 0.006
_STEPS_AS_ONE = 4.0  # see vertical.py
_LOW = 0.02  # centile of the lowest points of the feet where there are no steps (HumanCalib)
# That centile lies below the feet by noise and above it by a foot that never stood, 30 mm each.
_NO_STEPS_SIGMA = 0.018


@dataclass(frozen=True)
class Floor:
    """How high the floor is along the vertical, in the gauge and unit of the joints."""

    height: float
    sigma: float
    """Standard deviation where the person walked, in the same unit."""


def find_floor(
    joints_m: Float[np.ndarray, "frame joint 3"], up: Float[np.ndarray, 3], anatomy: Anatomy, steps: Steps
) -> Floor:
    """The height of the floor, which is below the points of a standing foot by what is known of feet.

    Raises:
        ValueError: no foot was ever seen.
    """
    stature = anatomy.stature_m(joints_m)
    share, share_sigma = anatomy.foot_height
    if len(steps):
        # Of a foot on the floor, heel or toes are lowest; when the heel has risen, it is not the foot's height.
        heights = (steps.lowest_m @ up).min(axis=1)
        height, sigma = _lower_half(heights), max(_spread(heights), _FOOT_SIGMA * stature)
        sigma /= np.sqrt(max(len(steps) / _STEPS_AS_ONE, 1.0))
    else:
        height, sigma = _lowest(anatomy.feet_m(joints_m) @ up), _NO_STEPS_SIGMA * stature
    return Floor(height - share * stature, float(np.hypot(sigma, share_sigma * stature)))


def _lower_half(heights: Float[np.ndarray, " step"]) -> float:
    """Median of the lower half: of steps on things, and of feet whose heel has risen, the other half consists."""
    return float(np.quantile(heights, 0.25))


def _spread(heights: Float[np.ndarray, " step"]) -> float:
    return float(np.subtract(*np.quantile(heights, [0.5, 0.1587])))


def _lowest(heights: Float[np.ndarray, "frame foot part"]) -> float:
    known = heights[np.isfinite(heights)]
    if not known.size:
        raise ValueError("there is no floor: no foot is known in any frame")
    return float(np.quantile(known, _LOW))
