"""Epipolar geometry of two cameras, and the shift between their clocks, from one walker: found together.

A joint that moves is seen by a late camera where it was not when the other one saw it: it misses its epipolar line by
its velocity times the shift, unless it moves along the line. Where the cameras stand is unknown too, so both are
estimated together (Albl et al. 2017, On the two-view geometry of unsynchronized cameras), by the Sampson error; between
cameras whose poses are known, the shift alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from fgpose.calibration.from_people.starts.clocks import ClockShift
from fgpose.calibration.from_people.starts.views import HALF_STRIDE_S, View
from fgpose.geometry.epipolar_distance import sampson_errors
from fgpose.sampling import spread_evenly
from fgpose_factors.robust_statistics import CAUCHY_SCALE, SIGMA_OF_MEDIAN

SPREAD = 0.05
"""25 mm at a body of 0.5 m radius: what detectors miss a joint by, biases included."""
_MAX_SAMPLES = 500
_MAX_ROBUST_POINTS = 800
_MIN_POINTS = 60
_MAX_ROUNDS = 12
_CONVERGED_S = 1e-4
_MAX_STEP_S = 0.08  # further than this the joints do not move straight on
_BLOCK_S = 1.0  # errors are correlated for 0.15 s, biases as long as somebody is seen from one side
_MIN_STRIDE = 4  # samples, of which one is that itself
INDEPENDENT_S = 0.3
"""Twice the correlation time of the errors of detections."""
_EPSILON = 1e-6
# Of the nine numbers: seven of the geometry, shift and rate of the clock.
_ALL, _CLOCK = slice(0, 9), slice(7, 9)
RATE_SIGMA = 1.5e-4
"""Of one clock relative to another: each drifts by 43 to 145 ppm."""


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

    xy: Float[np.ndarray, "camera point 2"]
    """In the first and in the second camera."""
    velocity: Float[np.ndarray, "camera point 2"]
    """Per second."""
    fast: Float[np.ndarray, "camera point 2"]
    """The part of it that changes within a stride."""
    spread: Float[np.ndarray, " point"]
    time_s: Float[np.ndarray, " point"]
    """By the clock of the second camera, since the middle."""
    known: Bool[np.ndarray, "sample joint"]
    """Which joints of which samples the points are, in this order."""
    stride: int
    """Samples of a stride."""
    independent: float
    """Share of the samples that there would be if there were one for each independent error."""

    def without_slow_part(self, values: Float[np.ndarray, " point"]) -> Float[np.ndarray, " point"]:
        """Less the mean over a stride of the same joint."""
        from scipy.ndimage import uniform_filter1d

        grid = np.zeros(self.known.shape)
        grid[self.known] = values
        sums, counts = (
            uniform_filter1d(array, self.stride, axis=0, mode="constant") for array in (grid, self.known.astype(float))
        )
        return values - (sums / np.maximum(counts, 1e-9))[self.known]


@dataclass(frozen=True, eq=False)
class _Geometry:
    """A fundamental matrix as U [A 0; 0 0] V^T: a rank of two without a singularity (unlike U diag(1, s, 0) V^T, where
    U and V may turn together if s is 1, as it is with true intrinsics)."""

    U: Float[np.ndarray, "3 3"]
    A: Float[np.ndarray, "2 2"]
    """Of unit norm."""
    V: Float[np.ndarray, "3 3"]

    @staticmethod
    def of(F: Float[np.ndarray, "3 3"]) -> _Geometry:
        U, singular, Vt = np.linalg.svd(F)
        U, Vt = U * np.linalg.det(U), Vt * np.linalg.det(Vt)
        return _Geometry(U, np.diag(singular[:2]) / np.linalg.norm(singular[:2]), Vt.T)

    @property
    def F(self) -> Float[np.ndarray, "3 3"]:
        return self.U[:, :2] @ self.A @ self.V[:, :2].T

    def moved(self, step: Float[np.ndarray, " 7"]) -> _Geometry:
        """By turning the two epipoles, and changing A across itself."""
        import cv2

        U, V = (M @ cv2.Rodrigues(np.array([*w, 0.0]))[0] for M, w in ((self.U, step[:2]), (self.V, step[2:4])))
        across = np.linalg.svd(self.A.reshape(1, 4))[2][1:]
        A = self.A + (step[4:] @ across).reshape(2, 2)
        return _Geometry(U, A / np.linalg.norm(A), V)


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
    are_placed, prior_rate = first.is_placed and second.is_placed, rate
    geometry = _Geometry.of(second.essential_with(first)) if are_placed else _robust_geometry(points)
    if geometry is None:
        return None
    free = _CLOCK if are_placed else _ALL
    for _ in range(_MAX_ROUNDS):
        step = _Linearized.at(geometry, points, rate_sigma).step(rate - prior_rate, free)
        moved_s = float(np.clip(step[7], -_MAX_STEP_S, _MAX_STEP_S))
        geometry, shift_s, rate = geometry.moved(step[:7]), shift_s + moved_s, rate + float(step[8])
        again = _points(first, second, time_s, shift_s, rate, middle_s)
        if again is None:
            return None
        points = again
        if abs(moved_s) < _CONVERGED_S and np.abs(step[:7]).max() < 1e-4:
            break
    found = _Linearized.at(geometry, points, rate_sigma)
    clock = ClockShift(shift_s, rate, middle_s, found.covariance(rate_sigma, free))
    square = found.residual**2
    return EpipolarShift(clock, float(np.mean(square / (1 + square))), len(square), geometry.F)


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
    both = ((first, time_s), (second, middle_s + since_s))
    xy, velocity, fast = (
        np.stack([ask(view, at_s) for view, at_s in both]) for ask in (View.at, View.velocity_at, View.fast_velocity_at)
    )
    known = np.asarray(np.isfinite(xy + velocity).all(axis=(0, -1)))
    if known.sum() < _MIN_POINTS:
        return None
    xy, velocity, fast = (array[:, known] for array in (xy, velocity, fast))
    sample, _ = np.nonzero(known)
    radius = np.sqrt(np.mean([view.radius_at(at_s) ** 2 for view, at_s in both], axis=0))
    # Of a recording that is short, a part; where samples are too far apart, nothing is slow.
    stride = round(min(2 * HALF_STRIDE_S, float(np.ptp(since_s)) / 5) / float(np.median(np.diff(since_s))))
    independent = max(min(float(np.ptp(since_s)) / INDEPENDENT_S / len(since_s), 1.0), 1e-3)
    spread = SPREAD * radius[sample]
    return _Points(xy, velocity, fast, spread, since_s[sample], known, stride, independent)


def _robust_geometry(points: _Points) -> _Geometry | None:
    """Fundamental matrix of some of the points by MAGSAC."""
    import cv2

    some = spread_evenly(len(points.spread), _MAX_ROBUST_POINTS)
    # OpenCV is made for pixels; thresholds are absolute.
    unit = float(np.median(points.spread))
    first, second = (xy[some] / unit for xy in points.xy)
    F, _ = cv2.findFundamentalMat(first, second, cv2.USAC_MAGSAC, 3.0, 0.999, 2000)
    if F is None or F.shape != (3, 3) or not np.isfinite(F).all():
        return None
    scale = np.diag([1 / unit, 1 / unit, 1.0])
    return _Geometry.of(scale @ F @ scale)


@dataclass(frozen=True, eq=False)
class _Linearized:
    """Sampson errors near an estimate, by the seven numbers of the geometry, the shift and the rate."""

    residual: Float[np.ndarray, " point"]
    """Relative to the spreads."""
    swinging: Float[np.ndarray, " point"]
    """The part of it that changes within a stride, to which the bias of the detector hardly adds."""
    jacobian: Float[np.ndarray, "point 9"]
    instruments: Float[np.ndarray, "point 9"]
    """What the residuals must not be correlated with: the Jacobian, but with the fast part of the velocities only. The
    bias of a detector depends on the side from which it sees the body, and so does where people walk in the image."""
    signal: Float[np.ndarray, " point"]
    """Product of Jacobian and instrument of the shift, without the square of the noise that is in both."""
    time_s: Float[np.ndarray, " point"]
    prior: float
    """Information on the rate, in units of that of a point."""

    @staticmethod
    def at(geometry: _Geometry, points: _Points, rate_sigma: float) -> _Linearized:
        """When the clocks are right, a joint stays on its epipolar line: what its motion in one image does to the
        residual, its motion in the other one undoes. So the derivative by the shift can be had from either image, and
        the noise of the two is independent."""

        def residual(geometry: _Geometry, *moved: np.ndarray | float) -> np.ndarray:
            first, second = (xy + by for xy, by in zip(points.xy, moved or (0.0, 0.0), strict=True))
            return sampson_errors(geometry.F, first, second) / points.spread

        here = residual(geometry)
        jacobian = np.empty((len(here), 9))
        for n, step in enumerate(_EPSILON * np.eye(7)):
            jacobian[:, n] = (residual(geometry.moved(step)) - here) / _EPSILON
        # A late clock of the second camera: its joint is asked for at an earlier time, or that of the first at a later.
        of_first, fast_first = (
            (residual(geometry, _EPSILON * v[0], 0.0) - here) / _EPSILON for v in (points.velocity, points.fast)
        )
        of_second, fast_second = (
            (residual(geometry, 0.0, -_EPSILON * v[1]) - here) / _EPSILON for v in (points.velocity, points.fast)
        )
        instruments = jacobian.copy()
        for array, derivative in ((jacobian, of_first + of_second), (instruments, fast_first + fast_second)):
            array[:, 7] = derivative / 2
            array[:, 8] = array[:, 7] * points.time_s
        prior = rate_sigma**-2 / points.independent
        swinging = points.without_slow_part(here) if points.stride > _MIN_STRIDE else here
        return _Linearized(here, swinging, jacobian, instruments, fast_first * fast_second, points.time_s, prior)

    @property
    def _squares(self) -> Float[np.ndarray, "kind point"]:
        """Of the residual and its swinging part, relative to the widths of the kernels: 95 % efficient for the errors
        as they are (Cauchy)."""
        both = np.stack([self.residual, self.swinging])
        widths = CAUCHY_SCALE * SIGMA_OF_MEDIAN * np.median(np.abs(both), axis=1, keepdims=True)
        return (both / np.maximum(widths, 1e-9)) ** 2

    def _information(self, weights: Float[np.ndarray, "kind point"]) -> Float[np.ndarray, "9 9"]:
        """Not symmetric: of instruments and Jacobian. The prior of the rate is in it."""
        information = (self.instruments * np.repeat(weights, [7, 2], axis=0).T).T @ self.jacobian
        signal = weights[1] * self.signal
        moments = [float(signal @ self.time_s**power) for power in range(3)]
        information[7:, 7:] = [[moments[0], moments[1]], [moments[1], moments[2]]]
        information[8, 8] += self.prior
        return information

    @property
    def _scores(self) -> Float[np.ndarray, "point 9"]:
        """Of which the sums are to be zero: of the residual for the geometry, of its swinging part for the clocks."""
        weighted = np.stack([self.residual, self.swinging]) / (1 + self._squares)
        return self.instruments * np.repeat(weighted, [7, 2], axis=0).T

    def step(self, from_prior_rate: float, free: slice) -> Float[np.ndarray, " 9"]:
        """To residuals that are not correlated with the instruments, by the numbers that are free."""
        gradient = self._scores.sum(axis=0)
        gradient[8] += self.prior * from_prior_rate
        step = np.zeros(9)
        step[free] = -_solved(self._information(1 / (1 + self._squares))[free, free], gradient[free])
        return step

    def covariance(self, rate_sigma: float, free: slice) -> Float[np.ndarray, "2 2"]:
        """Of shift and rate: the sandwich estimator over blocks of a second (Liang and Zeger 1986), within which errors
        may be correlated in any way. The prior of the rate counts as an observation."""
        _, block = np.unique(np.floor(self.time_s / _BLOCK_S), return_inverse=True)
        scores = np.zeros((block.max() + 1, 9))
        np.add.at(scores, block, self._scores)
        meat = scores.T @ scores * len(scores) / max(len(scores) - 1, 1)
        meat[8, 8] += (self.prior * rate_sigma) ** 2
        # What the weighted residuals do when the residuals change, on average: outliers do not follow.
        squares = self._squares
        information = self._information((1 - squares) / (1 + squares) ** 2)[free, free]
        inverse = _solved(information, np.eye(len(information)))
        return (inverse @ meat[free, free] @ inverse.T)[-2:, -2:]


def _solved(
    information: Float[np.ndarray, "free free"], right: Float[np.ndarray, "free ..."]
) -> Float[np.ndarray, "free ..."]:
    """With a damping that only counts where the points say nothing."""
    scale = np.sqrt(np.maximum(np.abs(np.diag(information)), 1e-12))
    damped = information / np.outer(scale, scale) + 1e-6 * np.eye(len(scale))
    shape = (-1, *(1,) * (right.ndim - 1))
    return np.linalg.solve(damped, right / scale.reshape(shape)) / scale.reshape(shape)
