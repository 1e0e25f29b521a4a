"""Epipolar geometry of two cameras, and the shift between their clocks, from one walker: found together.

A joint that moves is seen by a late camera where it was not when the other one saw it: it misses its epipolar line by
its velocity times the shift, unless it moves along the line. Both are unknown, so both are estimated together (Albl et
al. 2017, On the two-view geometry of unsynchronized cameras), by the Sampson error.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float

from fgpose.calibration.from_people.clocks import ClockShift
from fgpose.calibration.from_people.views import View
from fgpose.sampling import spread_evenly

# 25 mm at a body of 0.5 m radius: what detectors miss a joint by, biases included.
_SPREAD = 0.05
_MAX_SAMPLES = 500
_MAX_ROBUST_POINTS = 800
_MIN_POINTS = 60
_MAX_ROUNDS = 12
_CONVERGED_S = 1e-4
_MAX_STEP_S = 0.08  # further than this the joints do not move straight on
_BLOCK_S = 1.0  # errors are correlated for 0.15 s, biases as long as somebody is seen from one side
_INDEPENDENT_S = 0.3  # twice the correlation time
_EPSILON = 1e-6
RATE_SIGMA = 1e-4
"""Clocks of cameras drift by 43 to 145 ppm."""


@dataclass(frozen=True, eq=False)
class EpipolarShift:
    """Two cameras that see one walker."""

    clock: ClockShift
    """Its covariance is from how blocks of a second disagree."""
    misfit: float
    """Mean of r^2 / (1 + r^2) over all joints, r the Sampson error relative to 25 mm at the body: 0 is perfect, 1 is
    nonsense."""
    n_points: int
    F: Float[np.ndarray, "3 3"]
    """x_second^T F x_first = 0 in the images at unit focal length."""


@dataclass(frozen=True, eq=False)
class _Points:
    """Corresponding points, one row for each joint of each sample."""

    first: Float[np.ndarray, "point 2"]
    second: Float[np.ndarray, "point 2"]
    velocity: Float[np.ndarray, "point 2"]
    """Of the second, per second."""
    spread: Float[np.ndarray, " point"]
    time_s: Float[np.ndarray, " point"]
    """By the clock of the second camera, since the middle."""
    independent: float
    """Share of the samples that there would be if there were one for each independent error."""


@dataclass(frozen=True, eq=False)
class _Geometry:
    """A fundamental matrix as U diag(1, s, 0) V^T (Bartoli and Sturm 2004)."""

    U: Float[np.ndarray, "3 3"]
    s: float
    V: Float[np.ndarray, "3 3"]

    @staticmethod
    def of(F: Float[np.ndarray, "3 3"]) -> _Geometry:
        U, singular, Vt = np.linalg.svd(F)
        U, Vt = U * np.linalg.det(U), Vt * np.linalg.det(Vt)
        return _Geometry(U, float(singular[1] / singular[0]), Vt.T)

    @property
    def F(self) -> Float[np.ndarray, "3 3"]:
        return self.U @ np.diag([1.0, self.s, 0.0]) @ self.V.T

    def moved(self, step: Float[np.ndarray, " 7"]) -> _Geometry:
        U, V = (M @ cv2.Rodrigues(w)[0] for M, w in ((self.U, step[:3]), (self.V, step[3:6])))
        return _Geometry(U, float(np.clip(self.s + step[6], 1e-3, 1.0)), V)


def fit_epipolar_shift(
    first: View, second: View, shift_s: float, rate: float = 0.0, rate_sigma: float = RATE_SIGMA
) -> EpipolarShift | None:
    """The geometry and the shift near a proposed one (within about 0.1 s) that explain the detections best.

    Gauss-Newton with a Cauchy kernel; after each step the second camera is asked again for its joints at the new time.

    Args:
        rate: prior of the rate of the clock.
        rate_sigma: its standard deviation.

    Returns:
        None where the two have too few joints in common.
    """
    time_s = _common_times_s(first, second, shift_s)
    if not len(time_s):
        return None
    middle_s = float(time_s.mean()) - shift_s
    points = _points(first, second, time_s, shift_s, rate, middle_s)
    if points is None:
        return None
    geometry, prior_rate = _robust_geometry(points), rate
    if geometry is None:
        return None
    for _ in range(_MAX_ROUNDS):
        residual, jacobian = _linearized(geometry, points)
        step = _step(residual, jacobian, rate - prior_rate, rate_sigma**-2 / points.independent)
        moved_s = float(np.clip(step[7], -_MAX_STEP_S, _MAX_STEP_S))
        geometry, shift_s, rate = geometry.moved(step[:7]), shift_s + moved_s, rate + float(step[8])
        again = _points(first, second, time_s, shift_s, rate, middle_s)
        if again is None:
            return None
        points = again
        if abs(moved_s) < _CONVERGED_S and np.abs(step[:7]).max() < 1e-4:
            break
    residual, jacobian = _linearized(geometry, points)
    covariance = _covariance(residual, jacobian, points, rate_sigma)
    misfit = float(np.mean(residual**2 / (1 + residual**2)))
    return EpipolarShift(ClockShift(shift_s, rate, middle_s, covariance), misfit, len(residual), geometry.F)


def _common_times_s(first: View, second: View, shift_s: float) -> Float[np.ndarray, " sample"]:
    """Times of images of the first camera, by its clock, at which both see the walker; a number that is enough."""
    if len(first.time_s) < 2 or len(second.time_s) < 2:
        return np.zeros(0)
    inside = (first.time_s >= second.time_s[0] + shift_s) & (first.time_s <= second.time_s[-1] + shift_s)
    seen = np.isfinite(first.xy).all(axis=-1).any(axis=-1)
    candidates = np.flatnonzero(inside & seen)
    if not candidates.size:
        return np.zeros(0)
    known = np.isfinite(second.at(first.time_s[candidates] - shift_s)).all(axis=-1).any(axis=-1)
    candidates = candidates[known]
    return first.time_s[candidates[spread_evenly(len(candidates), _MAX_SAMPLES)]] if candidates.size else np.zeros(0)


def _points(
    first: View, second: View, time_s: Float[np.ndarray, " sample"], shift_s: float, rate: float, middle_s: float
) -> _Points | None:
    """None if there are too few."""
    since_s = (time_s - shift_s - middle_s) / (1 + rate)
    at_s = middle_s + since_s
    xy, others, velocity = first.at(time_s), second.at(at_s), second.velocity_at(at_s)
    square = (first.radius_at(time_s) ** 2 + second.radius_at(at_s) ** 2) / 2
    sample, joint = np.nonzero(np.isfinite(xy + others + velocity).all(axis=-1))
    if len(sample) < _MIN_POINTS:
        return None
    spread = _SPREAD * np.sqrt(square)[sample]
    independent = min(float(np.ptp(since_s)) / _INDEPENDENT_S / len(since_s), 1.0)
    rows = (array[sample, joint] for array in (xy, others, velocity))
    return _Points(*rows, spread, since_s[sample], max(independent, 1e-3))


def _robust_geometry(points: _Points) -> _Geometry | None:
    """Fundamental matrix of some of the points by MAGSAC."""
    some = spread_evenly(len(points.first), _MAX_ROBUST_POINTS)
    # OpenCV is made for pixels; thresholds are absolute.
    unit = float(np.median(points.spread))
    first, second = points.first[some] / unit, points.second[some] / unit
    F, _ = cv2.findFundamentalMat(first, second, cv2.USAC_MAGSAC, 3.0, 0.999, 2000)
    if F is None or F.shape != (3, 3) or not np.isfinite(F).all():
        return None
    scale = np.diag([1 / unit, 1 / unit, 1.0])
    return _Geometry.of(scale @ F @ scale)


def _residual(geometry: _Geometry, points: _Points, second: Float[np.ndarray, "point 2"]) -> Float[np.ndarray, " point"]:
    """Sampson errors relative to their spreads."""
    F = geometry.F
    line = points.first @ F[:, :2].T + F[:, 2]
    other_line = second @ F[:2] + F[2]
    algebraic = np.sum(second * line[:, :2], axis=1) + line[:, 2]
    square = np.sum(line[:, :2] ** 2, axis=1) + np.sum(other_line[:, :2] ** 2, axis=1)
    return algebraic / np.sqrt(np.maximum(square, 1e-18)) / points.spread


def _linearized(
    geometry: _Geometry, points: _Points
) -> tuple[Float[np.ndarray, " point"], Float[np.ndarray, "point 9"]]:
    """Residual, and its Jacobian by the seven numbers of the geometry, the shift and the rate."""
    residual = _residual(geometry, points, points.second)
    jacobian = np.empty((len(residual), 9))
    for n in range(7):
        # Downwards: s is 1 at most.
        step = np.zeros(7)
        step[n] = -_EPSILON
        jacobian[:, n] = (_residual(geometry.moved(step), points, points.second) - residual) / -_EPSILON
    # The joint is asked for at a time that is earlier by the shift.
    ahead = _residual(geometry, points, points.second - _EPSILON * points.velocity)
    jacobian[:, 7] = (ahead - residual) / _EPSILON
    jacobian[:, 8] = jacobian[:, 7] * points.time_s
    return residual, jacobian


def _step(
    residual: Float[np.ndarray, " point"],
    jacobian: Float[np.ndarray, "point 9"],
    from_prior_rate: float,
    prior: float,
) -> Float[np.ndarray, " 9"]:
    """Of Gauss-Newton, with the information that the prior of the rate has in units of one point's."""
    weight = 1 / (1 + residual**2)
    weighted = jacobian * weight[:, None]
    information, gradient = jacobian.T @ weighted, weighted.T @ residual
    information[8, 8] += prior
    gradient[8] += prior * from_prior_rate
    return -_solved(information, gradient)


def _solved(information: Float[np.ndarray, "9 9"], right: Float[np.ndarray, "9 *shape"]) -> Float[np.ndarray, "9 *shape"]:
    """With a damping that only counts where the points say nothing, as of the turn that U and V share if s is 1."""
    scale = np.sqrt(np.maximum(np.diag(information), 1e-12))
    damped = information / np.outer(scale, scale) + 1e-6 * np.eye(9)
    shape = (-1, *(1,) * (right.ndim - 1))
    return np.linalg.solve(damped, right / scale.reshape(shape)) / scale.reshape(shape)


def _covariance(
    residual: Float[np.ndarray, " point"], jacobian: Float[np.ndarray, "point 9"], points: _Points, rate_sigma: float
) -> Float[np.ndarray, "2 2"]:
    """Of shift and rate: the sandwich estimator over blocks of a second (Liang and Zeger 1986), within which errors may
    be correlated in any way. The prior of the rate counts as an observation."""
    weight, prior = 1 / (1 + residual**2), rate_sigma**-2 / points.independent
    information = jacobian.T @ (jacobian * weight[:, None])
    information[8, 8] += prior
    _, block = np.unique(np.floor(points.time_s / _BLOCK_S), return_inverse=True)
    scores = np.zeros((block.max() + 1, 9))
    np.add.at(scores, block, jacobian * (weight * residual)[:, None])
    meat = scores.T @ scores * len(scores) / max(len(scores) - 1, 1)
    meat[8, 8] += (prior * rate_sigma) ** 2
    inverse = _solved(information, np.eye(9))
    return (inverse @ meat @ inverse.T)[7:, 7:]
