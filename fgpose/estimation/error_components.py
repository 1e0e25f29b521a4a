"""The errors of a recording's detections as a sum of components, and what each of them does to the joints.

Pose networks have all of these: white noise; errors that are correlated for some time (first-order Gauss-Markov
processes); and a constant for each joint in each camera, which no number of frames averages out. How large each is
cannot be read from the residuals. The pose follows the detections, slow errors the most, and with two cameras little of
those is left in the residuals. So each component is simulated with variance 1, and the joints deviate as the linearised
problem says. Then the variances are those with which the simulated residuals have the autocovariance of the real ones
(non-negative least squares: a method of moments for variance components). And the covariance of the joints is that of
their simulated deviations with these variances, plus what bones and motion leave uncertain.
"""

from __future__ import annotations

import itertools

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.estimation.noise import (
    CORRELATED_FACTOR,
    CORRELATION_S,
    ErrorCorrelation,
    correlated_frames,
    surely_positive,
)
from fgpose.estimation.segment import Segment
from fgpose.estimation.solvers.block_tridiagonal import one_blas_thread
from fgpose.estimation.solvers.normal_equations import Linearized, NormalEquations
from fgpose.sampling import usual_step_s

# Correlation times of the components, from white to constant. Others in between look like two of them.
_TIMES_S = (0.0, 0.05, CORRELATION_S, 0.5, np.inf)
# Deviations are averaged over the axes of a joint and over so much time as well. Then so few samples give standard
# deviations to some 5 %.
_SAMPLES, _AVERAGED_S = 8, 1.0
# The autocovariance is taken up to this lag, at so many of them.
_LONGEST_LAG_S, _MOST_LAGS = 1.0, 12
_GOOD_WEIGHT = 0.3  # detections with less are left out: hallucinations have correlations of their own
# So many pairs of detections, counted as independent, outweigh what is usual. One camera and one joint give 7 a second.
_PRIOR_PAIRS = 10.0
_LEAST_FACTOR = 0.05  # what is left of a variance where nothing errs


def covariance_of_errors_m2(
    segment: Segment, positions_m: Float[np.ndarray, "frame joint 3"]
) -> Float[np.ndarray, "frame joint 3 3"]:
    """Covariance of every active joint around the solution of a segment; NaN elsewhere.

    Raises:
        ValueError: a joint is not held by any factor.
    """
    linearized, step_s = NormalEquations(segment).linearized(positions_m), usual_step_s(segment.evidence.time_s)
    with one_blas_thread():
        covariance_m2 = surely_positive(linearized.covariance_m2())
        known = _known(segment, linearized)
        lags = _lags(segment.n_frames, step_s)
        rng, residuals, deviations_m2 = np.random.default_rng(0), [], []
        for time_s in _TIMES_S:
            residual, deviation_m2 = _simulated(linearized, known, lags, _correlation(time_s, step_s), rng)
            residuals.append(residual)
            deviations_m2.append(_averaged(deviation_m2, step_s))
    real, pairs = _autocovariance(linearized.residual, known, lags)
    independent = pairs / correlated_frames(step_s, CORRELATION_S)
    variances = _variances(np.stack(residuals, axis=1), real, independent)
    of_graph_m2 = _averaged(np.nan_to_num(np.trace(covariance_m2[:, segment.joints], axis1=-2, axis2=-1)), step_s)
    of_bones_and_motion_m2 = np.maximum(of_graph_m2 - deviations_m2[0], 0.0)  # the graph takes all errors for white
    total_m2 = of_bones_and_motion_m2 + np.tensordot(variances, np.stack(deviations_m2), axes=1)
    factor = np.divide(total_m2, of_graph_m2, out=np.ones_like(total_m2), where=of_graph_m2 > 0)
    covariance_m2[:, segment.joints] *= np.maximum(factor, _LEAST_FACTOR)[..., None, None]
    return covariance_m2 + segment.evidence.common_bias_m2


def _known(segment: Segment, linearized: Linearized) -> Bool[np.ndarray, "frame camera slot"]:
    """Detections that are probably of their joints."""
    weights = segment.evidence.weights[:, :, segment.joints]
    return np.asarray(linearized.jacobian.any(axis=(-2, -1)) & (weights > _GOOD_WEIGHT))


def _lags(n_frames: int, step_s: float) -> Int[np.ndarray, " lag"]:
    """In frames; the first is none."""
    longest = min(int(_LONGEST_LAG_S / step_s), n_frames - 1)
    return np.unique([0, *np.geomspace(1, max(longest, 1), _MOST_LAGS).astype(int)]) if longest else np.zeros(1, int)


def _correlation(time_s: float, step_s: float) -> float:
    """Of errors of consecutive frames."""
    return 1.0 if np.isinf(time_s) else float(np.exp(-step_s / max(time_s, 1e-9)))


def _simulated(
    linearized: Linearized,
    known: Bool[np.ndarray, "frame camera slot"],
    lags: Int[np.ndarray, " lag"],
    correlation: float,
    rng: np.random.Generator,
) -> tuple[Float[np.ndarray, " lag"], Float[np.ndarray, "frame slot"]]:
    """Autocovariance of the residuals, and variance of the joints (sum over the axes), of errors of variance 1."""
    residual, deviation_m2 = np.zeros(len(lags)), np.zeros((len(known), known.shape[-1]))
    samples = _samples(known.shape, correlation, rng)
    for errors in samples:
        deviation_m = linearized.deviation_m(errors)
        left = errors - np.einsum("tcjia,tja->tcji", linearized.jacobian, deviation_m)
        residual += _autocovariance(left, known, lags)[0] / len(samples)
        deviation_m2 += np.sum(deviation_m**2, axis=-1) / len(samples)
    return residual, deviation_m2


def _samples(
    shape: tuple[int, ...], correlation: float, rng: np.random.Generator
) -> Float[np.ndarray, "sample frame camera slot 2"]:
    """Of a first-order Gauss-Markov process of variance 1.

    What is new in each frame is orthogonal for each joint over the samples, between the detections of four cameras: so
    few samples have exactly the covariance there that many would have.
    """
    n_frames, n_cameras, n_slots = shape
    n_new, n_groups = n_frames if correlation < 1 else 1, -(-2 * n_cameras // _SAMPLES)
    new, _ = np.linalg.qr(rng.standard_normal((n_new, n_slots, n_groups, _SAMPLES, _SAMPLES)))
    new *= rng.choice([-1.0, 1.0], (n_new, n_slots, n_groups, 1, _SAMPLES))  # LAPACK chooses the signs, not at random
    by_detection = np.sqrt(_SAMPLES) * new.swapaxes(2, 3).reshape(n_new, n_slots, _SAMPLES, -1)
    errors = by_detection[..., : 2 * n_cameras].reshape(n_new, n_slots, _SAMPLES, n_cameras, 2)
    errors[1:] *= np.sqrt(1 - correlation**2)
    for earlier, later in itertools.pairwise(errors):
        later += correlation * earlier
    return np.broadcast_to(errors.transpose(2, 0, 3, 1, 4), (_SAMPLES, *shape, 2))


def _autocovariance(
    residuals: Float[np.ndarray, "frame camera slot 2"],
    known: Bool[np.ndarray, "frame camera slot"],
    lags: Int[np.ndarray, " lag"],
) -> tuple[Float[np.ndarray, " lag"], Float[np.ndarray, " lag"]]:
    """Per axis of the image, and of how many pairs of detections."""
    residuals, n_frames = np.where(known[..., None], residuals, 0.0), len(residuals)
    products = [np.sum(residuals[: n_frames - lag] * residuals[lag:]) for lag in lags.tolist()]
    pairs = np.array([np.sum(known[: n_frames - lag] & known[lag:]) for lag in lags.tolist()], dtype=float)
    return np.array(products) / np.maximum(2 * pairs, 1.0), pairs


def _variances(
    simulated: Float[np.ndarray, "lag component"], real: Float[np.ndarray, " lag"], pairs: Float[np.ndarray, " lag"]
) -> Float[np.ndarray, " component"]:
    """Of the components, in those of the graph."""
    from scipy.optimize import nnls

    usual = ErrorCorrelation()
    shares = {0.0: 1 - usual.share, usual.time_s: usual.share}
    prior = np.array([shares.get(time_s, 0.0) for time_s in _TIMES_S]) / CORRELATED_FACTOR**2
    weight = np.sqrt(pairs)[:, None]
    rows = np.concatenate([weight * simulated, np.sqrt(_PRIOR_PAIRS) * np.eye(len(prior))])
    return nnls(rows, np.append(weight[:, 0] * real, np.sqrt(_PRIOR_PAIRS) * prior))[0]


def _averaged(values: Float[np.ndarray, "frame slot"], step_s: float) -> Float[np.ndarray, "frame slot"]:
    from scipy.ndimage import uniform_filter1d

    # Frames may be nanoseconds apart: to average more than there are tells nothing, and takes memory without bound.
    width = np.clip(int(_AVERAGED_S / step_s), 1, 2 * len(values))
    return uniform_filter1d(values, int(width), axis=0, mode="nearest")
