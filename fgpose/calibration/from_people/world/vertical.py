"""The vertical, from a walker: people are upright on average, and the floor that they walk on is level.

The axis of the body (ankles to head) is the vertical plus a lean. How somebody leans is constant in the frame of the
body, forwards and to the side, so that it cancels where he walks in several directions; where he walks in one, it is
known to a few degrees only. There the floor helps: it contains the way of the feet (HumanCalib removes the component
of the axis along the way for this reason). Both are one least-squares problem in the tilt, the lean and the height of
the feet.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from fgpose.calibration.from_people.world.anatomy import Anatomy
from fgpose.calibration.from_people.world.steps import STEPS_AS_ONE, Steps
from fgpose.kinematics.vertical import geometric_median
from fgpose_factors.robust_statistics import CAUCHY_SCALE, MEDIAN_LENGTH, robust_sigma

# Of the axis from ankles to head over a walk, forwards and to the side, radians: 3 degrees, as single frames are off.
_LEAN_SIGMA = np.deg2rad(3.0)
# Least standard deviation of the axis of a frame, and over how many seconds its errors are the same: a step.
_AXIS_SIGMA, _AXIS_CORRELATION_S = np.deg2rad(2.0), 0.5
# Least standard deviation of the height of a standing foot, as a share of the stature: 10 mm, half of the bias of a
# detected joint that depends on the direction it is seen from (20 to 40 mm in the image, averaged over the views).
FOOT_SIGMA = 0.006
_UPRIGHT = np.deg2rad(25.0)
_ROUNDS = 10  # of re-weighting; the vertical moves by less than 0.01 degrees after five
_LEAST_SIGMA_DEG = 0.15  # what is left if everything averages out: the level of floors


@dataclass(frozen=True, eq=False)
class Vertical:
    """Where up is, in the gauge of the joints."""

    up: Float[np.ndarray, " 3"]
    """Unit vector."""
    covariance: Float[np.ndarray, "3 3"]
    """Of that vector."""
    upright: float
    """Share of the frames in which the axis of the body is within 25 degrees of it."""

    @property
    def sigma_deg(self) -> float:
        """Standard deviation of its direction, root of the sum over both axes."""
        return float(np.rad2deg(np.sqrt(np.trace(self.covariance))))


def find_vertical(
    joints_m: Float[np.ndarray, "frame joint 3"], time_s: Float[np.ndarray, " frame"], anatomy: Anatomy, steps: Steps
) -> Vertical:
    """The vertical of a walk.

    Args:
        joints_m: of one walker, in any gauge and unit; NaN = missing.
        time_s: of the frames, increasing.
        anatomy: of the skeleton.
        steps: of the walk.

    Raises:
        ValueError: in no frame both ankles and the head or the shoulders are known.
    """
    axis, left = _axes(joints_m, anatomy)
    if not len(axis):
        raise ValueError("there is no vertical: head (or shoulders) and ankles are never known in the same frame")
    frame_s = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 1.0
    per_frame = min(1.0, frame_s / _AXIS_CORRELATION_S)
    up, covariance = geometric_median(axis), np.eye(2)
    up /= np.linalg.norm(up)
    for _ in range(_ROUNDS):
        upright = np.asarray(axis @ up > np.cos(_UPRIGHT))
        if not upright.any():
            break
        stature = anatomy.stature_m(joints_m)
        problem = _of_axes(axis[upright], left[upright], up, per_frame) + _of_steps(steps, up, stature)
        covariance = np.linalg.inv(problem[:, :-1])
        tilt = covariance @ problem[:, -1]
        up = up + tilt[:2] @ _plane(up)
        up /= np.linalg.norm(up)
    plane = _plane(up)
    of_up = plane.T @ (covariance[:2, :2] + np.deg2rad(_LEAST_SIGMA_DEG) ** 2 / 2 * np.eye(2)) @ plane
    return Vertical(up, of_up, float(np.mean(axis @ up > np.cos(_UPRIGHT))))


def _axes(
    joints_m: Float[np.ndarray, "frame joint 3"], anatomy: Anatomy
) -> tuple[Float[np.ndarray, "known 3"], Float[np.ndarray, "known 3"]]:
    """Unit vectors from the ankles to the head, and to the left, of the frames in which both are known."""
    axis_m = anatomy.top_m(joints_m) - anatomy.bottom_m(joints_m)
    length_m, left = np.linalg.norm(axis_m, axis=-1, keepdims=True), anatomy.left(joints_m)
    known = (length_m[:, 0] > 0) & np.isfinite(left).all(axis=-1)
    return axis_m[known] / length_m[known], left[known]


def _plane(up: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "2 3"]:
    """Two unit vectors at right angles to each other and to the vertical."""
    first = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(up, first)])


def _of_axes(
    axis: Float[np.ndarray, "known 3"],
    left: Float[np.ndarray, "known 3"],
    up: Float[np.ndarray, " 3"],
    per_frame: float,
) -> Float[np.ndarray, "5 6"]:
    """Normal equations of the axes in (tilt 2, lean forwards, lean to the left, height of the feet)."""
    plane = _plane(up)
    sideways = left @ plane.T
    sideways /= np.maximum(np.linalg.norm(sideways, axis=1, keepdims=True), 1e-9)
    forwards = np.stack([sideways[:, 1], -sideways[:, 0]], axis=1)  # left x up; plane[0], plane[1], up is right-handed
    rows = np.zeros((len(axis), 2, 5))
    rows[:, :, :2], rows[:, :, 2], rows[:, :, 3] = np.eye(2), forwards, sideways
    prior = np.diag([0.0, 0.0, _LEAN_SIGMA**-2, _LEAN_SIGMA**-2, 0.0])
    return _normal(rows, axis @ plane.T, _AXIS_SIGMA, per_frame) + np.column_stack([prior, np.zeros(5)])


def _of_steps(steps: Steps, up: Float[np.ndarray, " 3"], stature: float) -> Float[np.ndarray, "5 6"]:
    """Normal equations of the heights of the feet, which are the same at all steps."""
    if not len(steps):
        return np.column_stack([np.diag([0.0, 0.0, 0.0, 0.0, 1.0]), np.zeros(5)])
    around = (steps.foot_m - np.median(steps.foot_m, axis=0)) / stature
    rows = np.zeros((len(around), 1, 5))
    rows[:, 0, :2], rows[:, 0, 4] = around @ _plane(up).T, -1.0
    return _normal(rows, -(around @ up)[:, None], FOOT_SIGMA, 1 / STEPS_AS_ONE)


def _normal(
    rows: Float[np.ndarray, "row axis 5"], values: Float[np.ndarray, "row axis"], least_sigma: float, count: float
) -> Float[np.ndarray, "5 6"]:
    """Robust (Cauchy) normal equations, each row counting as so many independent measurements; their standard deviation
    is that of the residuals around what fits best, and no less than least_sigma."""
    sigma, normal = least_sigma, _weighted(rows, values, np.ones(len(rows)))
    for _ in range(3):
        fit = np.linalg.lstsq(normal[:, :-1], normal[:, -1], rcond=1e-9)[0]
        residual = np.linalg.norm(values - rows @ fit, axis=1)
        sigma = max(least_sigma, _robust_sigma(residual, values.shape[1]))
        weights = 1 / (1 + (residual / (CAUCHY_SCALE * sigma)) ** 2)
        normal = _weighted(rows, values, weights)
    return normal * count / sigma**2


def _weighted(rows: np.ndarray, values: np.ndarray, weights: Float[np.ndarray, " row"]) -> Float[np.ndarray, "5 6"]:
    both = np.concatenate([rows, values[..., None]], axis=-1)
    return np.einsum("n,nia,nib->ab", weights, rows, both)


def _robust_sigma(length: Float[np.ndarray, " row"], n_axes: int) -> float:
    """Per axis, from the lengths of Gaussian vectors."""
    return robust_sigma(length) if n_axes == 1 else float(np.median(length)) / MEDIAN_LENGTH


def is_upright(
    joints_m: Float[np.ndarray, "frame joint 3"], up: Float[np.ndarray, " 3"], anatomy: Anatomy
) -> Bool[np.ndarray, " frame"]:
    """Whether the axis of the body is within 25 degrees of the vertical; false where it is not known."""
    axis_m = anatomy.top_m(joints_m) - anatomy.bottom_m(joints_m)
    return np.asarray(axis_m @ up > np.cos(_UPRIGHT) * np.linalg.norm(axis_m, axis=-1))
