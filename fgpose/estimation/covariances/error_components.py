"""What the errors of a recording's detections do to the joints.

Pose networks have white noise, errors that are correlated for some time, and a constant for each joint in each camera
(variance_components). How large each is cannot be read from the residuals of the graph: the pose
follows the detections, slow errors the most, and detections that do not agree with it were rejected. So it is taken
from what the views of each frame contradict each other by (detection_errors), with the detections
that were rejected although a visible joint might have given them. Then each component is simulated, with the
correlation between joints that was found, and the joints deviate as the linearised problem says. The covariance of the
joints is that of their simulated deviations, plus what bones and motion leave uncertain, as much as the residuals show
of it: people move less roughly than white noise on the acceleration, or more.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from fgpose.estimation.covariances.alike_frames import AVERAGED_S, AlikeFrames
from fgpose.estimation.covariances.detection_errors import (
    TellingDetections,
    accepted,
    products_later,
)
from fgpose.estimation.covariances.length_effects import LengthEffects
from fgpose.estimation.covariances.rig_errors import MOVE_MEMORY_S, SURELY_M, CameraMoves, JointMoves, without_move
from fgpose.estimation.covariances.roughness import TELLS_AGAIN_S, roughness
from fgpose.estimation.covariances.uncertainty import LEAST_FACTOR
from fgpose.estimation.covariances.variance_components import (
    LONGEST_STEP_S,
    TIMES_S,
    ErrorComponents,
    correlation_after,
    size_in_stretch,
)
from fgpose.estimation.noise import sizes_around_frames, surely_positive
from fgpose.estimation.segment import Segment
from fgpose.estimation.solvers.block_tridiagonal import one_blas_thread
from fgpose.estimation.solvers.normal_equations import Linearized, NormalEquations
from fgpose.estimation.visibility.spread import spread_m_of
from fgpose.sampling import usual_step_s

# So many samples are drawn at once, until they are so many independent pieces of the time over which they are averaged.
# The inverse of a covariance from n of these is n / (n - 4) times as large as it should be on average.
_SAMPLES, _PIECES = 8, 64
_LEAST_TELLING = 1e-3  # of the variance of the graph
# Variances that differ by more may be of errors of other kinds.
_OTHER_KIND = 2.0


def covariance_of_errors_m2(
    segment: Segment, positions_m: Float[np.ndarray, "frame joint 3"]
) -> tuple[Float[np.ndarray, "frame joint 3 3"], Float[np.ndarray, " joint"]]:
    """Covariance of every active joint around the solution of a segment, NaN elsewhere; and the variance of the
    lasting errors of each joint's detections, in that of the graph."""
    linearized, joints = NormalEquations(segment).linearized(positions_m), segment.joints
    step_s = _step_s(segment)
    bias_share = segment.evidence.bias_share[:, joints, None, None]
    with one_blas_thread():
        covariance_m2 = surely_positive(linearized.covariance_m2())
        of_cameras_m2, residual = _of_cameras(segment, linearized, positions_m, step_s)
        telling = _telling(segment, linearized, residual)
        rng = np.random.default_rng(0)
        lasting_in_views = _lasting_in_views(segment, linearized, telling)
        deviations, lasting = Deviations.none(linearized), 0.0
        for sizes in _kinds(segment, positions_m, _sizes(telling, step_s)):
            components = _components(segment, telling.in_sizes(sizes), step_s)
            lasting = lasting + np.mean(sizes > 0) * components.lasting
            deviations += Deviations.of(linearized, components, bias_share, step_s, rng, lasting_in_views, sizes)
        in_graph_m2 = covariance_m2[:, joints]
        alike = AlikeFrames.of(in_graph_m2, np.asarray(linearized.weight > 0).sum(axis=1), step_s)
        tells = segment.evidence.observed[:, joints]
        of_motion = share_of_motion(linearized, deviations, in_graph_m2, alike, tells, step_s, rng)
        relative = alike.relative(deviations.covariance_m2)
        relative += np.maximum(of_motion, LEAST_FACTOR)[..., None, None] * np.eye(3)
        known = alike.known
        root = np.linalg.cholesky(in_graph_m2[known])
        found_m2 = root @ relative[known] @ root.swapaxes(-1, -2) + (bias_share * of_cameras_m2)[known]
    frames, slots = np.nonzero(known)
    covariance_m2[frames, joints[slots]] = found_m2
    lasting_of_all = np.ones(positions_m.shape[1])
    lasting_of_all[joints] = lasting
    return covariance_m2, lasting_of_all


def length_covariance_of_errors_m2(
    segment: Segment, positions_m: Float[np.ndarray, "frame joint 3"]
) -> Float[np.ndarray, "length length"]:
    """Covariance of the shared bone lengths around the solution of a segment. Frames may be far apart: what does not
    change from one to the next is constant. A camera that has moved makes errors that last."""
    linearized, step_s = NormalEquations(segment).linearized(positions_m), _step_s(segment)
    with one_blas_thread():
        telling = _telling(segment, linearized, _with_bias(segment, linearized))
        effects = LengthEffects.of(linearized, segment.evidence.time_s, segment.evidence.bias_share[:, segment.joints])
        lasting_in_views = _lasting_in_views(segment, linearized, telling)
        covariance_m2 = effects.of_rest_m2 + effects.taken_m2(linearized.residual)
        for sizes in _kinds(segment, positions_m, _sizes(telling, step_s)):
            components = _components(segment, telling.in_sizes(sizes), step_s)
            covariance_m2 = covariance_m2 + effects.covariance_m2(components, lasting_in_views, sizes)
    return covariance_m2


@dataclass(frozen=True, eq=False)
class Deviations:
    """Of the joints, from simulated errors of their detections."""

    samples_m: Float[np.ndarray, "sample frame slot 3"]
    covariance_m2: Float[np.ndarray, "frame slot 3 3"]
    """Of as many samples as tell it once it is averaged over AVERAGED_S."""

    @staticmethod
    def none(linearized: Linearized) -> Deviations:
        """Of detections without errors."""
        n_frames, _, n_slots = linearized.weight.shape
        return Deviations(np.zeros((_SAMPLES, n_frames, n_slots, 3)), np.zeros((n_frames, n_slots, 3, 3)))

    def __add__(self, other: Deviations) -> Deviations:
        """Of independent errors."""
        return Deviations(self.samples_m + other.samples_m, self.covariance_m2 + other.covariance_m2)

    @staticmethod
    def of(
        linearized: Linearized,
        components: ErrorComponents,
        bias_share: Float[np.ndarray, "frame slot 1 1"] | float,
        step_s: float,
        rng: np.random.Generator,
        lasting: Float[np.ndarray, "camera slot"] | float = 1.0,
        sizes: Float[np.ndarray, " frame"] | float = 1.0,
    ) -> Deviations:
        """From errors with these components, of whose constant part this much is left, and of whose lasting ones each
        view has so many times as much as all together; in each frame the variance of all is so many times as large."""
        (n_frames, _, n_slots), mixing = linearized.weight.shape, components.mixing
        samples_m, covariance_m2 = np.zeros((_SAMPLES, n_frames, n_slots, 3)), np.zeros((n_frames, n_slots, 3, 3))
        root_size = np.sqrt(np.broadcast_to(sizes, n_frames))[:, None, None, None]
        for time_s, variance in zip(TIMES_S, components.variances.T, strict=True):
            if not variance.any():
                continue
            of_views = np.broadcast_to(components.in_views(time_s, lasting), linearized.weight.shape[1:])
            sigma = np.sqrt(of_views[..., None] * variance[:, None] * components.axes)
            correlation = float(correlation_after(time_s, np.array([step_s]))[0])
            rounds, share = _rounds(time_s, n_frames, step_s), bias_share if np.isinf(time_s) else 1.0
            for number in range(rounds):
                errors = _samples(linearized.weight.shape, correlation, rng)
                own_m = np.stack([linearized.deviation_m(root_size * sigma * (mixing @ sample)) for sample in errors])
                covariance_m2 += share * np.einsum("stja,stjb->tjab", own_m, own_m) / (rounds * _SAMPLES)
                if number == 0:
                    samples_m += own_m
        return Deviations(samples_m, covariance_m2)


def share_of_motion(
    linearized: Linearized,
    deviations: Deviations,
    of_graph_m2: Float[np.ndarray, "frame slot 3 3"],
    alike: AlikeFrames,
    tells: Bool[np.ndarray, "frame slot"],
    step_s: float,
    rng: np.random.Generator,
) -> Float[np.ndarray, "frame slot"]:
    """What bones and motion leave uncertain, in the variance of the graph.

    The graph is a filter H. From the positions x + n that detections alone would give, with errors n, it takes
    (1 - H) (x + n) away, which is in the residuals; (1 - H) x is what is wrong because people move otherwise than bones
    and motion say. Filtered once more, H (1 - H) (x + n), hardly any noise is left (twicing, Tukey 1977). As far as it
    exceeds what the simulated n makes of it, it tells how much larger or smaller (1 - H) x is than in the graph.

    Args:
        linearized: the problem.
        deviations: from errors as they are.
        of_graph_m2: covariance of the graph.
        alike: the frames over which is averaged.
        tells: the joints whose residuals count.
        step_s: from frame to frame.
        rng: of the errors.
    """

    def filtered_m(deviation_m: Float[np.ndarray, "frame slot 3"]) -> Float[np.ndarray, "frame slot 3"]:
        return linearized.deviation_m(np.einsum("tcjia,tja->tcji", linearized.jacobian, deviation_m))

    white = Deviations.of(linearized, ErrorComponents.white(tells.shape[1]), 1.0, step_s, rng)
    twice_m = np.stack([filtered_m(sample) for sample in white.samples_m])
    in_graph_m2 = alike.averaged(np.sum(twice_m * (white.samples_m - twice_m), axis=(0, -1)) / _SAMPLES)
    off_m = np.stack([sample - filtered_m(sample) for sample in deviations.samples_m])
    noise_m2 = alike.averaged(np.sum(off_m**2, axis=(0, -1)) / _SAMPLES)
    found_m2 = np.sum(linearized.deviation_m(linearized.residual) ** 2, axis=-1)
    share = np.maximum(1 - np.trace(alike.relative(white.covariance_m2), axis1=-2, axis2=-1) / 3, 0.0)
    tells = alike.known & tells & (in_graph_m2 > _LEAST_TELLING * np.trace(of_graph_m2, axis1=-2, axis2=-1))
    if not tells.any():
        return share
    measurements = float(tells.sum()) * min(step_s / TELLS_AGAIN_S, 1.0)
    return share * roughness(found_m2[tells], noise_m2[tells], in_graph_m2[tells], measurements)


def _step_s(segment: Segment) -> float:
    return min(usual_step_s(segment.evidence.time_s), LONGEST_STEP_S)


def _with_bias(segment: Segment, linearized: Linearized) -> Float[np.ndarray, "frame camera slot 2"]:
    """The residuals against the detections themselves."""
    evidence = segment.evidence
    bias = np.nan_to_num(evidence.bias_px / evidence.detection_sigma_px[..., None])
    return linearized.residual - bias[:, :, segment.joints]


def _telling(
    segment: Segment, linearized: Linearized, residual: Float[np.ndarray, "frame camera slot 2"]
) -> TellingDetections:
    return TellingDetections.of(residual, linearized.jacobian, segment.evidence.weights[:, :, segment.joints])


def _components(segment: Segment, telling: TellingDetections, step_s: float) -> ErrorComponents:
    """Of the errors of the detections."""
    return ErrorComponents.told_by(telling, step_s, [segment.skeleton.joints[joint] for joint in segment.joints])


def _sizes(telling: TellingDetections, step_s: float) -> Float[np.ndarray, " frame"]:
    """Variance of the errors around each frame, in that of the recording."""
    _, of_all = telling.parities
    squared, dimensions = products_later(of_all, of_all)
    return sizes_around_frames(lambda part: size_in_stretch(squared[part], dimensions[part]), len(squared), step_s)


def _kinds(
    segment: Segment, positions_m: Float[np.ndarray, "frame joint 3"], sizes: Float[np.ndarray, " frame"]
) -> list[Float[np.ndarray, " frame"]]:
    """The sizes in frames with small errors and in those with large ones, 0 in the others: what makes errors larger
    lasts for another time than the rest. One kind where they differ by less than tells."""
    evidence, px_per_m = segment.evidence, segment.rig.px_per_m(positions_m)
    told = evidence.detected & np.isfinite(px_per_m)
    if not told.any():
        return [sizes]
    # The graph may take them for larger there already.
    in_usual = evidence.sigma_px / px_per_m / spread_m_of(evidence, px_per_m)[:, None]
    n_told = told.sum(axis=(1, 2))
    variance = sizes * np.sum(in_usual**2, axis=(1, 2), where=told) / np.maximum(n_told, 1)
    least, largest = np.percentile(variance[n_told > 0], [5, 95])
    if largest < _OTHER_KIND * least:
        return [sizes]
    is_large = variance > np.sqrt(least * largest)
    return [np.where(of_kind, sizes, 0.0) for of_kind in (~is_large, is_large)]


def _lasting_in_views(
    segment: Segment, linearized: Linearized, telling: TellingDetections
) -> Float[np.ndarray, "camera slot"]:
    """How many times as much of the lasting errors each view has as all together, in the variance of the graph: what
    lasts is the network's, of the same angle in all views, and what makes one of them worse is white noise."""
    evidence, (parity, _) = segment.evidence, telling.parities
    good = accepted(linearized.jacobian, evidence.weights[:, :, segment.joints])
    told = np.sum(parity.known - np.sum(parity.explained**2, axis=-1), axis=0)
    told = np.maximum(told.reshape(len(told), -1, 2).sum(axis=-1).T, 0.0)
    sigma_rad = evidence.detection_sigma_px[:, :, segment.joints] / segment.rig.focal_px[:, None]
    variance_rad2 = np.sum(np.where(good, sigma_rad**2, 0.0), axis=0) / np.maximum(good.sum(axis=0), 1)
    inverse = np.divide(1.0, variance_rad2, out=np.zeros_like(variance_rad2), where=variance_rad2 > 0)
    together = np.sum(told * inverse, axis=0) / np.maximum(told.sum(axis=0), 1e-12)
    return np.divide(inverse, together, out=np.ones_like(inverse), where=(inverse > 0) & (together > 0))


def _of_cameras(
    segment: Segment, linearized: Linearized, positions_m: Float[np.ndarray, "frame joint 3"], step_s: float
) -> tuple[Float[np.ndarray, "frame slot 3 3"], Float[np.ndarray, "frame camera slot 2"]]:
    """What is uncertain because a camera may not be where the rig has it, were that not found by its bias; and the
    residuals without what a camera explains that has surely moved. Stretches overlap by half."""
    jacobian, positions_m = linearized.jacobian, positions_m[:, segment.joints]
    residual, good = _with_bias(segment, linearized), accepted(jacobian, segment.evidence.weights[:, :, segment.joints])
    joints = JointMoves.of(jacobian, good, positions_m, segment.rig)
    moves = CameraMoves.of(residual, joints)
    half = max(int(MOVE_MEMORY_S / 2 / step_s), 1)
    parts = [slice(start, start + half) for start in range(0, segment.n_frames, half)]
    around = [(slice(max(part.start - half, 0), part.stop), slice(part.start, part.stop + half)) for part in parts]
    without = residual.copy()
    for part, (before, _) in zip(parts, around, strict=True):
        moved = moves.sums(before).most_likely()
        without[part] = without_move(residual[part], jacobian[part], positions_m[part], moved, segment.rig)
    telling = _telling(segment, linearized, without)
    independent = _components(segment, telling, step_s).independent(MOVE_MEMORY_S, step_s)
    found_m2 = np.zeros((*jacobian.shape[:1], *jacobian.shape[2:3], 3, 3))
    for part, stretches in zip(parts, around, strict=True):
        moments_m2 = np.mean([moves.sums(stretch).moments(independent) for stretch in stretches], axis=0)
        found_m2[part] = joints.covariance_m2(moments_m2, part)
        if np.trace(moments_m2, axis1=-2, axis2=-1).max() > SURELY_M**2:
            residual[part] = without[part]
    return found_m2, residual


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


def _rounds(time_s: float, n_frames: int, step_s: float) -> int:
    """How many times samples of errors that last for so long are drawn."""
    pieces_of_sample = max(min(AVERAGED_S, n_frames * step_s) / max(time_s, step_s), 1.0)
    return max(round(_PIECES / _SAMPLES / pieces_of_sample), 1)
