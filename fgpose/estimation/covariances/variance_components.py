"""The errors of each joint's detections as a sum of components that last for different times.

White noise, processes that are correlated for some time (first-order Gauss-Markov), and a constant for each joint in
each camera, which no number of frames averages out. Their variances are those that give the autocovariance found in the
recording (non-negative least squares: a method of moments for variance components). Joints err differently: a network
knows a shoulder better than a hip. How much they differ is estimated too, and each joint is drawn towards the mean of
all as far as its own measurements leave open (empirical Bayes). So are the two axes of the image: a hip is known better
vertically than horizontally.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from fgpose.estimation.covariances.detection_errors import (
    ErrorProducts,
    TellingDetections,
    lags_of,
    share_of_visible,
)
from fgpose.estimation.noise import CORRELATED_FACTOR, CORRELATION_S, ErrorCorrelation, correlated_frames
from fgpose.sampling import spread_evenly
from fgpose_factors.robust_statistics import medians

TIMES_S = (0.0, 0.05, CORRELATION_S, 0.5, np.inf)
"""Correlation times of the components, from white to constant. Others in between look like two of them."""
LONGEST_STEP_S = 1e3
"""From frame to frame: beyond what any component lasts. A single frame has no next one."""
MOST_FRAMES = 1000
"""Of one sum; frames may be nanoseconds apart."""
# So many pairs of detections, counted as independent, outweigh what is usual. One camera and one joint give 7 a second.
_PRIOR_PAIRS = 10.0
_PRIOR_PAIRS_OF_JOINT = 1.0  # the joint's own fit is shrunk afterwards
_FEWEST = 3  # joints that tell how much joints differ
_LEAST_FREEDOM = 0.5
# The t distribution with fewer has hardly a variance.
_LEAST_TOTAL_FREEDOM = 4.0
# Of the variances along the axes of the image from each other, in their sum: standard deviation before anything is
# known, and the most that is believed.
_USUAL_DIFFERENCE, _MOST_DIFFERENCE = 0.3, 0.9
# What is known of networks, where a recording does not tell: of the lasting errors of hips the variance is three times
# as large horizontally as vertically, of all other joints together as large (OpenPose, BlazePose full and heavy against
# three other cameras: fgpose_benchmarks/data/detection_errors). Half of it, for that is one man.
_OF_HIPS, _HIPS = 0.5, ("hip", "pelvis")
_STEPS = 200  # of the integral over the squared correlation
_CORRELATION_FRAMES = 200  # tell how the errors of joints are correlated; more take more memory and tell no more
_LEAST_OF_JOINT = 0.5  # of a joint in a frame: two cameras have 1, and none where they stand in line with it


@dataclass(frozen=True, eq=False)
class ErrorComponents:
    """Of the errors of detections, in the variances that the graph takes for them."""

    variances: Float[np.ndarray, "joint component"]
    """Of each of TIMES_S."""
    correlation: Float[np.ndarray, "joint joint"]
    """Between the joints of one view; positive semidefinite."""
    axes: Float[np.ndarray, "joint axis"]
    """Variance along the horizontal and the vertical axis of the images, in that of both."""

    @staticmethod
    def usual(joints: Sequence[str]) -> ErrorComponents:
        """Before anything is known: correlated as usual, with the variance of the graph, as if the fewest degrees of
        freedom had told it. The spread that it takes is learned from residuals, which are smaller online, where fewer
        frames contradict each other."""
        usual, n_joints = _of_student(_LEAST_TOTAL_FREEDOM) / _usual().sum() * _usual(), len(joints)
        # As two cameras of one height know them.
        axes = 1 + np.stack([2 * _usual_difference(joints), np.zeros(n_joints)], axis=1)
        return ErrorComponents(np.tile(usual, (n_joints, 1)), np.eye(n_joints), axes)

    @staticmethod
    def white(n_joints: int) -> ErrorComponents:
        """As the graph takes them."""
        variances = np.tile([float(time_s == 0) for time_s in TIMES_S], (n_joints, 1))
        return ErrorComponents(variances, np.eye(n_joints), np.ones((n_joints, 2)))

    @staticmethod
    def of(
        products: ErrorProducts, lags_s: Float[np.ndarray, " lag"], step_s: float, joints: Sequence[str] = ()
    ) -> ErrorComponents:
        """That explain these products; the names of the joints tell what is usual of networks."""
        decays = np.stack([correlation_after(time_s, lags_s) for time_s in TIMES_S], axis=1)
        pairs = products.later_dimensions / 2 / correlated_frames(step_s, CORRELATION_S)
        real = products.autocovariance
        of_all = _fitted(decays, _mean(real, pairs), pairs.sum(axis=1), _usual(), _PRIOR_PAIRS)
        freedom = products.later_dimensions[0] / _frames_as_one(of_all, products.n_frames, step_s)
        ratio = real[0] / max(of_all.sum(), 1e-12)
        prior = _freedom_of_mean(ratio, freedom)
        own = np.stack(
            [
                _fitted(decays, real[:, joint], pairs[:, joint], of_all * ratio[joint], _PRIOR_PAIRS_OF_JOINT)
                for joint in range(len(ratio))
            ]
        )
        share = (freedom / (freedom + prior))[:, None]
        total = np.maximum(freedom + prior, _LEAST_TOTAL_FREEDOM)[:, None]
        variances = _of_student(total) * (share * own + (1 - share) * of_all)
        frames_as_one = max(products.later_dimensions[0].sum() / max(freedom.sum(), 1e-12), 1.0)
        correlation = _shrunk(products.correlation, products.others_dimensions / frames_as_one)
        usual = _usual_difference(joints) if joints else np.zeros(len(ratio))
        return ErrorComponents(variances, correlation, _by_axis(products, freedom, usual))

    @staticmethod
    def told_by(telling: TellingDetections, step_s: float, joints: Sequence[str]) -> ErrorComponents:
        """Of the detections of frames that follow each other after this time, of joints with these names."""
        n_frames = len(telling.parities[0].residual)
        lags, spread = lags_of(n_frames, step_s), spread_evenly(n_frames, _CORRELATION_FRAMES)
        of_accepted, of_all = (ErrorProducts.of(parity, lags, spread) for parity in telling.parities)
        found = of_accepted.mixed(of_all, share_of_visible(telling.within, telling.around))
        return ErrorComponents.of(found, lags * step_s, step_s, joints)

    def of_joints(self, joints: Int[np.ndarray, " own_joint"]) -> ErrorComponents:
        """Of some of the joints."""
        return ErrorComponents(self.variances[joints], self.correlation[np.ix_(joints, joints)], self.axes[joints])

    def in_views(
        self, time_s: float, lasting: Float[np.ndarray, "camera joint"] | float
    ) -> Float[np.ndarray, "*camera joint"]:
        """By how much more or less of a component each view has, if it has so many times as much of the lasting ones as
        all together; its components together stay the same, if they can."""
        if time_s > 0:
            return lasting * np.ones(len(self.variances))
        white, others = self.variances[:, 0], self.variances[:, 1:].sum(axis=1)
        return np.maximum(white + others * (1.0 - lasting), 0.0) / np.maximum(white, 1e-12)

    @property
    def mixing(self) -> Float[np.ndarray, "joint joint"]:
        """Makes errors that are correlated between joints out of independent ones. The symmetric root: of others,
        rounding errors choose the signs of what is made."""
        values, vectors = np.linalg.eigh(self.correlation)
        return vectors * np.sqrt(np.maximum(values, 0.0)) @ vectors.T

    @property
    def lasting(self) -> Float[np.ndarray, " joint"]:
        """Variance of what lasts for longer than a few frames."""
        return self.variances[:, np.array(TIMES_S) >= CORRELATION_S].sum(axis=1)

    def independent(self, duration_s: float, step_s: float) -> float:
        """How much of an independent measurement, in the variance of the graph, each detection is of what all joints
        and all frames of so long have in common."""
        of_all = self.variances.mean(axis=0)
        after_s = step_s * np.arange(1, max(int(min(duration_s / step_s, MOST_FRAMES)), 1))
        weight = 1 - after_s / duration_s
        lasting = [np.sum(weight * correlation_after(time_s, after_s)) for time_s in TIMES_S[1:]]
        frames_as_one = 1 + 2 * float(of_all[1:] @ lasting) / max(float(of_all.sum()), 1e-12)
        joints_as_one = max(float(self.correlation.sum()) / len(self.correlation), 1.0)
        return 1 / (max(float(of_all.sum()), 1e-12) * frames_as_one * joints_as_one)


def size_in_stretch(
    squared: Float[np.ndarray, "frame joint"], dimensions: Float[np.ndarray, "frame joint"]
) -> tuple[float, float]:
    """Usual squared error of the joints in a stretch of frames in parity space, by dimension, and how many of these
    there are. The median: of errors that grow, the largest are taken for hallucinated."""
    known = dimensions > _LEAST_OF_JOINT
    if not known.any():
        return 0.0, 0.0
    # Half of a chi-squared is less than its mean (Wilson and Hilferty 1931): two views have one dimension.
    usual = dimensions[known] * (1 - 2 / (9 * dimensions[known])) ** 3
    return float(medians(squared[known] / usual)), float(dimensions.sum())


def correlation_after(time_s: float, lags_s: Float[np.ndarray, " lag"]) -> Float[np.ndarray, " lag"]:
    """Of the errors of a component after these times."""
    return np.ones(len(lags_s)) if np.isinf(time_s) else np.exp(-lags_s / max(time_s, 1e-9))


def covariance_of_sum(
    effects: Float[np.ndarray, "frame error unknown"], correlation: Float[np.ndarray, " frame"]
) -> Float[np.ndarray, "unknown unknown"]:
    """Covariance of the sum of the effects of errors of variance 1, each correlated with itself in the frame before: a
    first-order Gauss-Markov process, whose correlations multiply from frame to frame."""
    carried, both = np.zeros(effects.shape[1:]), np.zeros((effects.shape[-1],) * 2)
    for own, kept in zip(effects, correlation, strict=True):
        carried = kept * carried
        both += own.T @ carried
        carried += own
    return both + both.T + np.einsum("teu,tev->uv", effects, effects, optimize=True)


def _usual_difference(joints: Sequence[str]) -> Float[np.ndarray, " joint"]:
    return np.array([_OF_HIPS * any(hip in name for hip in _HIPS) for name in joints])


def _of_student(freedom: Float[np.ndarray, "*joints"] | float) -> Float[np.ndarray, "*joints"]:
    """Variance of errors in the estimate of it from so many degrees of freedom: they follow Student's t."""
    return np.asarray(freedom / (freedom - 2))


def _usual() -> Float[np.ndarray, " component"]:
    usual = ErrorCorrelation()
    shares = {0.0: 1 - usual.share, usual.time_s: usual.share}
    return np.array([shares.get(time_s, 0.0) for time_s in TIMES_S]) / CORRELATED_FACTOR**2


def _mean(values: Float[np.ndarray, "lag joint"], weights: Float[np.ndarray, "lag joint"]) -> Float[np.ndarray, " lag"]:
    total = weights.sum(axis=1)
    return np.divide(np.sum(weights * values, axis=1), total, out=np.zeros_like(total), where=total > 0)


def _fitted(
    decays: Float[np.ndarray, "lag component"],
    real: Float[np.ndarray, " lag"],
    pairs: Float[np.ndarray, " lag"],
    prior: Float[np.ndarray, " component"],
    prior_pairs: float,
) -> Float[np.ndarray, " component"]:
    from scipy.optimize import nnls

    weight = np.sqrt(np.maximum(pairs, 0.0))
    rows = np.concatenate([weight[:, None] * decays, np.sqrt(prior_pairs) * np.eye(len(prior))])
    return nnls(rows, np.append(weight * real, np.sqrt(prior_pairs) * prior))[0]


def _frames_as_one(variances: Float[np.ndarray, " component"], n_frames: float, step_s: float) -> float:
    """How many frames are one measurement of the variance: the sum of the squared correlations (Bartlett 1946)."""
    duration_s = n_frames * step_s
    after_s = (np.arange(_STEPS) + 0.5) / _STEPS * duration_s
    lasting = sum(v * correlation_after(time_s, after_s) for v, time_s in zip(variances[1:], TIMES_S[1:], strict=True))
    squared = (np.asarray(lasting) / max(variances.sum(), 1e-12)) ** 2 * (1 - after_s / duration_s)
    return float(np.clip(2 * np.mean(squared) * duration_s / step_s, 1.0, max(n_frames, 1.0)))


def _freedom_of_mean(ratio: Float[np.ndarray, " joint"], freedom: Float[np.ndarray, " joint"]) -> float:
    """How many degrees of freedom the mean of all joints counts as: the fewer, the more they differ.

    Args:
        ratio: variance of each joint in that of all.
        freedom: degrees of freedom of each.
    """
    tells = freedom > _LEAST_FREEDOM
    if np.sum(tells) < _FEWEST:
        return max(float(freedom.sum()), _LEAST_TOTAL_FREEDOM)
    weight = freedom[tells] / freedom[tells].sum()
    squared = np.sum(weight * (ratio[tells] / np.sum(weight * ratio[tells]) - 1) ** 2)
    by_chance = np.sum(weight * 2 / freedom[tells])
    between = max(float((squared - by_chance) / (1 + by_chance)), 0.0)
    return 1 / (between / 2 + 1 / float(freedom.sum()))


def _shrunk(
    correlation: Float[np.ndarray, "joint joint"], freedom: Float[np.ndarray, "joint joint"]
) -> Float[np.ndarray, "joint joint"]:
    """What chance does not explain of each correlation, as a positive semidefinite matrix of unit diagonal."""
    by_chance = (1 - correlation**2) ** 2 / np.maximum(freedom, 1.0)
    squared = np.maximum(correlation**2, 1e-12)
    shrunk = np.where(freedom > 1.0, correlation * np.maximum(1 - by_chance / squared, 0.0), 0.0)
    np.fill_diagonal(shrunk, 1.0)
    values, vectors = np.linalg.eigh((shrunk + shrunk.T) / 2)
    positive = (vectors * np.maximum(values, 0.0)) @ vectors.T
    sigma = np.sqrt(np.diag(positive))
    return positive / np.outer(sigma, sigma)


def _by_axis(
    products: ErrorProducts, freedom: Float[np.ndarray, " joint"], usual: Float[np.ndarray, " joint"]
) -> Float[np.ndarray, "joint axis"]:
    """Variance along each axis of the image in that of both, drawn towards the mean of all joints and towards usual
    differences as far as the measurements leave open. Two cameras of one height contradict each other vertically
    alone."""
    total = np.maximum(products.axes_dimensions.sum(axis=(1, 2)), 1e-9)
    dimensions = products.axes_dimensions / total[:, None, None]
    horizontal, vertical = np.moveaxis(dimensions.sum(axis=2), 1, 0)
    # The variances are 1 + 2 vertical d and 1 - 2 horizontal d.
    sum_of_both = products.axes.sum(axis=1)
    share = np.divide(products.axes[:, 0], sum_of_both, out=horizontal.copy(), where=sum_of_both > 0)
    by_difference = 2 * np.linalg.det(dimensions)
    information = freedom * by_difference**2 / np.maximum(2 * horizontal * vertical, 1e-9)
    tells = information > 1e-6
    difference = np.divide(share - horizontal, by_difference, out=usual.copy(), where=tells) - usual
    information = np.where(tells, information, 0.0)
    mean = np.sum(information * difference) / (information.sum() + 1 / _USUAL_DIFFERENCE**2)
    spread = np.sum(information * (difference - mean) ** 2) - (tells.sum() - 1)
    squared = information.sum() - np.sum(information**2) / max(information.sum(), 1e-9)
    between = max(float(spread / max(squared, 1e-9)), 1e-9)
    own = usual + mean + (difference - mean) * information / (information + 1 / between)
    own = np.clip(
        own, -_MOST_DIFFERENCE / 2 / np.maximum(vertical, 0.5), _MOST_DIFFERENCE / 2 / np.maximum(horizontal, 0.5)
    )
    return np.stack([1 + 2 * vertical * own, 1 - 2 * horizontal * own], axis=1)
