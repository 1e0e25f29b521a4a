"""What the errors of a recording's detections do to the joints.

Pose networks have white noise, errors that are correlated for some time, and a constant for each joint in each camera
(fgpose.estimation.variance_components). How large each is cannot be read from the residuals of the graph: the pose
follows the detections, slow errors the most, and detections that do not agree with it were rejected. So it is taken
from what the views of each frame contradict each other by (fgpose.estimation.detection_errors), with the detections
that were rejected although a visible joint might have given them. Then each component is simulated, with the
correlation between joints that was found, and the joints deviate as the linearised problem says. The covariance of the
joints is that of their simulated deviations, plus what bones and motion leave uncertain.
"""

from __future__ import annotations

import itertools

import numpy as np
from jaxtyping import Float

from fgpose.estimation.detection_errors import (
    ErrorProducts,
    TellingDetections,
    accepted,
    lags_of,
    share_of_visible,
)
from fgpose.estimation.noise import surely_positive
from fgpose.estimation.rig_errors import MEMORY_S, SURELY_M, CameraMoves, without_move
from fgpose.estimation.segment import Segment
from fgpose.estimation.solvers.block_tridiagonal import one_blas_thread
from fgpose.estimation.solvers.normal_equations import Linearized, NormalEquations
from fgpose.estimation.variance_components import TIMES_S, ErrorComponents, correlation_after
from fgpose.sampling import spread_evenly, usual_step_s

# Deviations are averaged over the axes of a joint and over so much time as well. Then so few samples give standard
# deviations to some 5 %.
_SAMPLES, _AVERAGED_S = 8, 1.0
_LEAST_FACTOR = 0.05  # what is left of a variance where nothing errs
_LONGEST_STEP_S = 1e3  # beyond any recording; a single frame has no next one
_CORRELATION_FRAMES = 200  # tell how the errors of joints are correlated; more take more memory and tell no more


def covariance_of_errors_m2(
    segment: Segment, positions_m: Float[np.ndarray, "frame joint 3"]
) -> Float[np.ndarray, "frame joint 3 3"]:
    """Covariance of every active joint around the solution of a segment; NaN elsewhere.

    Raises:
        ValueError: a joint is not held by any factor.
    """
    linearized = NormalEquations(segment).linearized(positions_m)
    step_s = min(usual_step_s(segment.evidence.time_s), _LONGEST_STEP_S)
    with one_blas_thread():
        covariance_m2 = surely_positive(linearized.covariance_m2())
        of_cameras_m2, residual = _of_cameras(segment, linearized, positions_m, step_s)
        components = _components(segment, linearized, residual, step_s)
        mixing, rng = _root(components.correlation), np.random.default_rng(0)
        deviations_m2 = np.stack([_simulated_m2(linearized, time_s, step_s, mixing, rng) for time_s in TIMES_S])
    bias_share = segment.evidence.bias_share[:, segment.joints]
    deviations_m2[-1] *= bias_share
    of_graph_m2 = _averaged(np.nan_to_num(np.trace(covariance_m2[:, segment.joints], axis1=-2, axis2=-1)), step_s)
    of_bones_and_motion_m2 = np.maximum(of_graph_m2 - deviations_m2[0], 0.0)  # the graph takes all errors for white
    total_m2 = of_bones_and_motion_m2 + np.einsum("jk,ktj->tj", components.variances, deviations_m2)
    factor = np.divide(total_m2, of_graph_m2, out=np.ones_like(total_m2), where=of_graph_m2 > 0)
    covariance_m2[:, segment.joints] *= np.maximum(factor, _LEAST_FACTOR)[..., None, None]
    covariance_m2[:, segment.joints] += bias_share[..., None, None] * of_cameras_m2
    return covariance_m2


def _with_bias(segment: Segment, linearized: Linearized) -> Float[np.ndarray, "frame camera slot 2"]:
    """The residuals against the detections themselves."""
    evidence = segment.evidence
    bias = np.nan_to_num(evidence.bias_px / evidence.detection_sigma_px[..., None])
    return linearized.residual - bias[:, :, segment.joints]


def _components(
    segment: Segment, linearized: Linearized, residual: Float[np.ndarray, "frame camera slot 2"], step_s: float
) -> ErrorComponents:
    """Of the errors of the detections, by these residuals."""
    telling = TellingDetections.of(residual, linearized.jacobian, segment.evidence.weights[:, :, segment.joints])
    lags, spread = lags_of(segment.n_frames, step_s), spread_evenly(segment.n_frames, _CORRELATION_FRAMES)
    of_accepted, of_all = (ErrorProducts.of(parity, lags, spread) for parity in telling.parities)
    found = of_accepted.mixed(of_all, share_of_visible(telling.within, telling.around))
    return ErrorComponents.of(found, lags * step_s, step_s)


def _of_cameras(
    segment: Segment, linearized: Linearized, positions_m: Float[np.ndarray, "frame joint 3"], step_s: float
) -> tuple[Float[np.ndarray, "frame slot 3 3"], Float[np.ndarray, "frame camera slot 2"]]:
    """What is uncertain because a camera may not be where the rig has it, were that not found by its bias; and the
    residuals without what a camera explains that has surely moved. Stretches overlap by half."""
    jacobian, positions_m = linearized.jacobian, positions_m[:, segment.joints]
    residual, good = _with_bias(segment, linearized), accepted(jacobian, segment.evidence.weights[:, :, segment.joints])
    moves = CameraMoves.of(residual, jacobian, good, positions_m, segment.rig)
    half = max(int(MEMORY_S / 2 / step_s), 1)
    parts = [slice(start, start + half) for start in range(0, segment.n_frames, half)]
    around = [(slice(max(part.start - half, 0), part.stop), slice(part.start, part.stop + half)) for part in parts]
    without = residual.copy()
    for part, (before, _) in zip(parts, around, strict=True):
        moved = moves.sums(before).most_likely()
        without[part] = without_move(residual[part], jacobian[part], positions_m[part], moved, segment.rig)
    independent = _components(segment, linearized, without, step_s).independent(MEMORY_S, step_s)
    found_m2 = np.zeros((*jacobian.shape[:1], *jacobian.shape[2:3], 3, 3))
    for part, stretches in zip(parts, around, strict=True):
        moments_m2 = np.mean([moves.sums(stretch).moments(independent) for stretch in stretches], axis=0)
        found_m2[part] = moves.covariance_m2(moments_m2, part)
        if np.trace(moments_m2, axis1=-2, axis2=-1).max() > SURELY_M**2:
            residual[part] = without[part]
    return found_m2, residual


def _root(correlation: Float[np.ndarray, "slot slot"]) -> Float[np.ndarray, "slot slot"]:
    values, vectors = np.linalg.eigh(correlation)
    return vectors * np.sqrt(np.maximum(values, 0.0))


def _simulated_m2(
    linearized: Linearized,
    time_s: float,
    step_s: float,
    mixing: Float[np.ndarray, "slot slot"],
    rng: np.random.Generator,
) -> Float[np.ndarray, "frame slot"]:
    """Variance of the joints (sum over the axes) from errors of variance 1 that are correlated over this time, and
    between joints by the product of the mixing matrix with its transpose."""
    correlation = float(correlation_after(time_s, np.array([step_s]))[0])
    samples = _samples(linearized.weight.shape, correlation, rng)
    deviation_m2 = np.zeros((len(linearized.weight), len(mixing)))
    for errors in samples:
        deviation_m2 += np.sum(linearized.deviation_m(mixing @ errors) ** 2, axis=-1) / len(samples)
    return _averaged(deviation_m2, step_s)


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


def _averaged(values: Float[np.ndarray, "frame slot"], step_s: float) -> Float[np.ndarray, "frame slot"]:
    from scipy.ndimage import uniform_filter1d

    # Frames may be nanoseconds apart: to average more than there are tells nothing, and takes memory without bound.
    width = np.clip(int(_AVERAGED_S / step_s), 1, 2 * len(values))
    return uniform_filter1d(values, int(width), axis=0, mode="nearest")
