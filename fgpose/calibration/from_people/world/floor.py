"""The floor, from the feet that stand on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.calibration.from_people.world.anatomy import Anatomy
from fgpose.calibration.from_people.world.steps import STEPS_AS_ONE, Steps
from fgpose.calibration.from_people.world.vertical import FOOT_SIGMA, Vertical, find_vertical

# Of the height of the foot, as a share of the stature: 14 mm of bias of its detections (20 to 40 mm in the image, less
# where several views agree), which no number of steps averages out on a way to and fro.
_BIAS_SIGMA = 0.008
# Degrees of freedom of what is usual of steps: with fewer the t distribution has hardly a variance.
_USUAL_FREEDOM = 4.0
_LOW = 0.02  # centile of the lowest points of the feet where there are no steps (HumanCalib)
# That centile lies below the feet by noise and above it by a foot that never stood, 30 mm each.
_NO_STEPS_SIGMA = 0.018


@dataclass(frozen=True)
class Floor:
    """How high the floor is along the vertical, in the gauge and unit of the joints."""

    height: float
    sigma: float
    """Standard deviation where the person walked, in the same unit."""


def find_vertical_and_floor(
    joints_m: Float[np.ndarray, "frame joint 3"], time_s: Float[np.ndarray, " frame"], anatomy: Anatomy
) -> tuple[Vertical, Floor]:
    """Of a walk, both from its steps. Raises ValueError as find_vertical and find_floor."""
    steps = Steps.of(joints_m, time_s, anatomy)
    vertical = find_vertical(joints_m, time_s, anatomy, steps)
    return vertical, find_floor(joints_m, vertical, anatomy, steps)


def find_floor(
    joints_m: Float[np.ndarray, "frame joint 3"], vertical: Vertical, anatomy: Anatomy, steps: Steps
) -> Floor:
    """The height of the floor, which is below the points of a standing foot by what is known of feet.

    Along a vertical that is wrong, one end of the walk is lower than the other, and the lowest steps are those there:
    the floor is then wrong where the person walked by the tilt times the extent of the walk.

    Raises:
        ValueError: no foot was ever seen.
    """
    stature, up = anatomy.stature_m(joints_m), vertical.up
    share, share_sigma = anatomy.foot_height
    if len(steps):
        # Of a foot on the floor, heel or toes are lowest; when the heel has risen, it is not the foot's height.
        heights = (steps.lowest_m @ up).min(axis=1)
        height, sigma = _lower_half(heights), _sigma_of_steps(heights, FOOT_SIGMA * stature)
        feet_m = steps.foot_m
    else:
        height, sigma = _lowest(anatomy.feet_m(joints_m) @ up), _NO_STEPS_SIGMA * stature
        feet_m = anatomy.feet_m(joints_m).reshape(-1, 3)
    of_feet = np.hypot(share_sigma, _BIAS_SIGMA) * stature
    of_tilt = _tilted(feet_m[np.isfinite(feet_m).all(axis=-1)], vertical)
    return Floor(height - share * stature, float(np.linalg.norm([sigma, of_feet, of_tilt])))


def _tilted(feet_m: Float[np.ndarray, "place 3"], vertical: Vertical) -> float:
    """Standard deviation of the height of a place of the walk against its middle, by that of the vertical."""
    around_m = feet_m - feet_m.mean(axis=0)
    return float(np.sqrt(np.mean(np.einsum("pa,ab,pb->p", around_m, vertical.covariance, around_m))))


def _lower_half(heights: Float[np.ndarray, " step"]) -> float:
    """Median of the lower half; the other half contains the steps on things, and feet whose heel has risen."""
    return float(np.quantile(heights, 0.25))


def _sigma_of_steps(heights: Float[np.ndarray, " step"], usual: float) -> float:
    """Standard deviation of what they tell of the height of a standing foot, which has a usual one at each step. A few
    steps hardly show how much they differ: it is drawn towards that, and what is left open widens it (Student's t)."""
    freedom = (len(heights) - 1) / STEPS_AS_ONE
    total = _USUAL_FREEDOM + freedom
    variance = (_USUAL_FREEDOM * usual**2 + freedom * _spread(heights) ** 2) / (total - 2)
    return float(np.sqrt(variance / max(len(heights) / STEPS_AS_ONE, 1.0)))


def _spread(heights: Float[np.ndarray, " step"]) -> float:
    """Standard deviation, from the lower half of a normal distribution."""
    return float(np.subtract(*np.quantile(heights, [0.5, 0.1587])))


def _lowest(heights: Float[np.ndarray, "frame foot part"]) -> float:
    known = heights[np.isfinite(heights)]
    if not known.size:
        raise ValueError("there is no floor: no foot is known in any frame")
    return float(np.quantile(known, _LOW))
