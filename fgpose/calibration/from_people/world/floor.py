"""The floor, from the feet that stand on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.calibration.from_people.world.anatomy import Anatomy
from fgpose.calibration.from_people.world.steps import STEPS_AS_ONE, Steps

# Of the height of the foot, as a share of the stature: 14 mm of bias of its detections (20 to 40 mm in the image, less
# where several views agree), which no number of steps averages out on a way to and fro.
_BIAS_SIGMA = 0.008
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
    joints_m: Float[np.ndarray, "frame joint 3"], up: Float[np.ndarray, " 3"], anatomy: Anatomy, steps: Steps
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
        height, sigma = _lower_half(heights), _spread(heights) / np.sqrt(max(len(steps) / STEPS_AS_ONE, 1.0))
    else:
        height, sigma = _lowest(anatomy.feet_m(joints_m) @ up), _NO_STEPS_SIGMA * stature
    of_feet = np.hypot(share_sigma, _BIAS_SIGMA) * stature
    return Floor(height - share * stature, float(np.hypot(sigma, of_feet)))


def _lower_half(heights: Float[np.ndarray, " step"]) -> float:
    """Median of the lower half; the other half contains the steps on things, and feet whose heel has risen."""
    return float(np.quantile(heights, 0.25))


def _spread(heights: Float[np.ndarray, " step"]) -> float:
    """Standard deviation, from the lower half of a normal distribution."""
    return float(np.subtract(*np.quantile(heights, [0.5, 0.1587])))


def _lowest(heights: Float[np.ndarray, "frame foot part"]) -> float:
    known = heights[np.isfinite(heights)]
    if not known.size:
        raise ValueError("there is no floor: no foot is known in any frame")
    return float(np.quantile(known, _LOW))
