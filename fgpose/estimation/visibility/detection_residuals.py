"""The residuals of detections, and what each says for a visible joint against a hallucinated one.

A visible joint is detected with a normal error, whose spread is learned for every camera of the recording: a camera
that has moved, or whose clock is off, has larger errors than the others. A hidden one is detected anywhere near it (a
Cauchy distribution) or where another joint of the person is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from jaxtyping import Bool, Float

from fgpose.config import Config, VisibilityConfig
from fgpose.estimation.evidence.evidence import Evidence
from fgpose.estimation.noise import CORRELATED_FACTOR, surely_positive
from fgpose.estimation.visibility.spread import Contradictions, spread_m
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.reprojection import linearized_projection
from fgpose.geometry.vectors import norm
from fgpose.sampling import parts_of
from fgpose.skeleton import Skeleton
from fgpose_factors import robust_weight
from fgpose_factors.robust_statistics import MEDIAN_LENGTH

# The numbers below were chosen on the tuning clips of the benchmark, standard family. Twice or half of each changes the
# mean errors there by less than 2 %, with two cameras 4 %.
#
# Share of hidden joints that are detected where another joint is, half of them at the mirrored one.
_OTHER_JOINT_SHARE, _MIRRORED_SHARE = 0.3, 0.5
# How exactly bones and motion alone predict a joint, by motion model. A joint that they do not hold follows a
# hallucination: its residual is small and tells little.
_PREDICTED_M = {"constant_velocity": 0.01, "random_walk": 0.02, "none": 0.04}
# How much the prior weight tells, relative to as much as if it were a probability.
_WEIGHT_EXPONENT = 0.3
_MOST_CERTAIN = 0.99
_FRAMES_AT_ONCE = 100
# Where less of the variance of a detection is left in its residual, that is of the pose rather than of the detection.
_LEAST_REDUNDANCY = 0.2


@dataclass(frozen=True, eq=False)
class LogDensities:
    """Logarithms of the densities of detections in their images, if their joints are at some place; up to a constant
    that all have in common."""

    visible: Float[np.ndarray, "*points"]
    """If the joint is visible."""
    hidden: Float[np.ndarray, "*points"]
    """If it is hallucinated."""
    other: Float[np.ndarray, "*points"]
    """If it is hallucinated, and another joint of the person was detected."""


@dataclass(frozen=True, eq=False)
class WithoutOwn:
    """What all detections of a joint but one say about it and about that one."""

    covariance_m2: Float[np.ndarray, "frame joint 3 3"]
    """Of the joint, by all detections."""
    left: Float[np.ndarray, "frame camera joint 2 2"]
    """Share of the covariance of each detection that is left in its residual."""
    residual_px: Float[np.ndarray, "frame camera joint 2"]
    """Against the joint without the detection."""
    covariance_px2: Float[np.ndarray, "frame camera joint 2 2"]
    """Of the projection of that joint."""


@dataclass(frozen=True, eq=False)
class DetectionResiduals:
    """The residuals of all detections against a pose, and what the pose owes to each of them."""

    positions_m: Float[np.ndarray, "frame joint 3"]
    undistorted_px: Float[np.ndarray, "frame camera joint 2"]
    seen: Bool[np.ndarray, "frame camera joint"]
    """Where there is a detection, of a joint that is estimated and in front of the camera."""
    px_per_m: Float[np.ndarray, "frame camera joint"]
    """Scale of the image at the joint; 1 where not seen."""
    weights: Float[np.ndarray, "frame camera joint"]
    contradictions: Contradictions
    """What is left of the residuals whatever the pose."""
    redundancy: Float[np.ndarray, "frame camera joint"]
    """Share of the variance of a detection that is left in its residual."""
    predictive_px: Float[np.ndarray, "frame camera joint 2"]
    """Residual against the pose without the detections of this camera."""
    predictive_px2: Float[np.ndarray, "frame camera joint 2 2"]
    """Covariance of that pose's projection."""
    length_m: Float[np.ndarray, "frame camera joint"]
    """Of the residual, at the joint; 0 where not seen."""
    log_occam: Float[np.ndarray, "frame joint"]
    """Logarithm of the share of what bones and motion leave open that is left when all detections are known."""

    @staticmethod
    def of(
        positions_m: Float[np.ndarray, "frame joint 3"],
        evidence: Evidence,
        rig: CameraRig,
        config: Config,
    ) -> DetectionResiduals:
        """Of the detections as they were when the pose was found: the smaller the standard deviation of a camera was
        there, the more the pose follows that camera, and the less its residuals tell."""
        residual_px, jacobian, seen = linearized_projection(evidence.undistorted_px, rig, positions_m)
        # See CameraRig.px_per_m: of each axis of the image, the length of the Jacobian's row.
        px_per_m = np.where(seen, np.sqrt(np.einsum("tcjia,tcjia->tcj", jacobian, jacobian) / 2), 1.0)
        length_px, weights, projection = norm(residual_px), evidence.weights, config.projection
        squared = (length_px / evidence.detection_sigma_px) ** 2
        kernel = robust_weight(squared, projection.kernel, projection.kernel_scale)
        information = np.where(seen, kernel / evidence.detection_sigma_px**2, 0.0)
        # As if the frames nearby had the same weights: their errors are correlated, and only the ratios count.
        predicted_m = _PREDICTED_M[config.motion.model]
        others = without_own(residual_px, jacobian, information, predicted_m)
        return DetectionResiduals(
            positions_m=positions_m,
            undistorted_px=evidence.undistorted_px,
            seen=seen,
            px_per_m=px_per_m,
            weights=weights,
            contradictions=Contradictions(residual_px, jacobian, information, px_per_m),
            redundancy=np.trace(others.left, axis1=-2, axis2=-1) / 2,
            predictive_px=others.residual_px,
            predictive_px2=others.covariance_px2,
            length_m=length_px / px_per_m,
            log_occam=0.5 * np.linalg.slogdet(others.covariance_m2 / predicted_m**2)[1],
        )

    @property
    def several(self) -> Bool[np.ndarray, "frame 1 joint"]:
        """Whether more than one camera sees the joint: it follows its only detection."""
        return self.seen.sum(axis=1, keepdims=True) >= 2

    @property
    def of_seen(self) -> tuple[Float[np.ndarray, "frame camera joint"], Float[np.ndarray, "frame camera joint"]]:
        """length_m and px_per_m; NaN where not seen."""
        return np.where(self.seen, self.length_m, np.nan), np.where(self.seen, self.px_per_m, np.nan)

    @cached_property
    def tells(self) -> Bool[np.ndarray, "measure frame camera joint"]:
        """Whose residual tells how large the errors of detections are: against the pose, and against the other views
        alone."""
        of_pose = self.seen & self.several & (self.redundancy > _LEAST_REDUNDANCY)
        return np.array([of_pose, self.contradictions.tells])

    @property
    def single_spread_m(self) -> Float[np.ndarray, "measure frame camera joint"]:
        """What each detection alone says for the spread, by either: half of those of a normal error say less."""
        of_pose_m = self.length_m / np.sqrt(np.where(self.tells[0], self.redundancy, 1.0)) / MEDIAN_LENGTH
        return np.array([of_pose_m, self.contradictions.single_spread_m])

    def spread_m(
        self, prior_m: float, independent: float, sizes: Float[np.ndarray, " frame"] | None = None
    ) -> Float[np.ndarray, " camera"]:
        """See spread.spread_m; where errors have the variance 1 in these sizes of each frame (None: in all)."""
        single_m = self.single_spread_m if sizes is None else self.single_spread_m / np.sqrt(sizes)[:, None, None]
        measures = zip(single_m, self.tells, strict=True)
        return np.min([spread_m(*measure, self.weights, prior_m, independent) for measure in measures], axis=0)

    def log_densities(
        self,
        spread_m: Float[np.ndarray, "#frame camera #joint"],
        rig: CameraRig,
        skeleton: Skeleton,
        config: VisibilityConfig,
    ) -> LogDensities:
        """Of each detection; what it alone says for visible against hidden is their difference.

        Args:
            spread_m: standard deviation of the residuals of visible detections along each axis of the image.
            rig, skeleton, config: as for fgpose.estimation.visibility.visibility.judged.
        """
        spread_px, residual = spread_m * self.px_per_m, (self.predictive_px, self.predictive_px2)
        other = self._log_density_at_others(spread_px, rig, skeleton)
        hidden = log_density_hidden(*residual, config.hallucinated_m * self.px_per_m, other)
        return LogDensities(log_density_visible(*residual, spread_px), hidden, other)

    @property
    def prior_log_odds(self) -> Float[np.ndarray, "frame camera joint"]:
        """What the weight that each detection had before says for visible against hidden."""
        weight = np.clip(self.weights, 1 - _MOST_CERTAIN, _MOST_CERTAIN)
        return np.asarray(_WEIGHT_EXPONENT * np.log(weight / (1 - weight)))

    def _log_density_at_others(
        self, spread_px: Float[np.ndarray, "frame camera joint"], rig: CameraRig, skeleton: Skeleton
    ) -> Float[np.ndarray, "frame camera joint"]:
        """As LogDensities.other."""
        projected_px, shares = rig.project(self.positions_m), _share_of_others(skeleton)
        of_all = np.empty(self.seen.shape)
        # Of all pairs of joints a window would take more memory than everything else that is made of it.
        for part in parts_of(len(of_all), _FRAMES_AT_ONCE):
            (x, y), (others_x, others_y) = (
                each[part].transpose(3, 0, 1, 2) for each in (self.undistorted_px, projected_px)
            )
            distance_px2 = (x[..., None] - others_x[:, :, None]) ** 2 + (y[..., None] - others_y[:, :, None]) ** 2
            # Both the detection and the projection err.
            density = np.exp(distance_px2 / (-4 * spread_px[part, ..., None] ** 2))
            np.copyto(density, 0.0, where=np.isnan(density))
            of_all[part] = np.einsum("tcjk,jk->tcj", density, shares)
        return np.log(np.maximum(of_all, np.finfo(float).tiny)) - np.log(2 * spread_px**2)


def lengths_m(
    evidence: Evidence, positions_m: Float[np.ndarray, "joint 3"], rig: CameraRig
) -> tuple[Float[np.ndarray, "camera joint"], Float[np.ndarray, "camera joint"]]:
    """Of the residuals of a frame, at the joints, and the scales of the images there; NaN where they are not known."""
    px_per_m = rig.px_per_m(positions_m)
    return norm(rig.project(positions_m) - evidence.undistorted_px[0]) / px_per_m, px_per_m


def without_own(
    residual_px: Float[np.ndarray, "frame camera joint 2"],
    jacobian: Float[np.ndarray, "frame camera joint 2 3"],
    information: Float[np.ndarray, "frame camera joint"],
    predicted_m: float,
) -> WithoutOwn:
    """Of joints at the optimum of their detections.

    Args:
        residual_px, jacobian: see linearized_projection.
        information: of each detection, 1/px^2; 0 of what is not used.
        predicted_m: standard deviation on each axis with which the joint is known besides.
    """
    weights = information[..., None, None]
    of_cameras = np.einsum("tcjia,tcjib->tjab", weights * jacobian, jacobian)
    # Next to a camera a joint is known to micrometres across and hardly at all along: singular but for rounding.
    covariance_m2 = np.linalg.inv(surely_positive(of_cameras + np.eye(3) / predicted_m**2))
    by_camera = np.einsum("tcjia,tjab->tcjib", jacobian, np.asfortranarray(covariance_m2))
    projected_px2 = np.einsum("tcjib,tcjkb->tcjik", by_camera, jacobian)
    left = np.eye(2) - weights * projected_px2
    without = _inverse(left)
    return WithoutOwn(
        covariance_m2=covariance_m2,
        left=left,
        residual_px=np.einsum("tcjik,tcjk->tcji", without, residual_px),
        covariance_px2=np.einsum("tcjik,tcjkl->tcjil", without, projected_px2),
    )


def log_density_visible(
    residual_px: Float[np.ndarray, "*points 2"],
    covariance_px2: Float[np.ndarray, "*points 2 2"],
    spread_px: Float[np.ndarray, "*points"],
) -> Float[np.ndarray, "*points"]:
    """See LogDensities.

    Args:
        residual_px, covariance_px2: against the joint without the detection; see WithoutOwn.
        spread_px: standard deviation of visible detections along each axis.
    """
    return _log_density(residual_px, covariance_px2, spread_px, lambda squared: -squared / 2)


def log_density_fitted(
    length_px: Float[np.ndarray, "*points"], spread_px: Float[np.ndarray, "*points"]
) -> Float[np.ndarray, "*points"]:
    """As log_density_visible, of a residual of this length against a joint that is exactly known."""
    return -((length_px / spread_px) ** 2) / 2 - 2 * np.log(spread_px)


def log_density_hidden(
    residual_px: Float[np.ndarray, "*points 2"],
    covariance_px2: Float[np.ndarray, "*points 2 2"],
    scale_px: Float[np.ndarray, "*points"],
    other: Float[np.ndarray, "*points"],
) -> Float[np.ndarray, "*points"]:
    """See LogDensities.

    Args:
        residual_px, covariance_px2: as for log_density_visible.
        scale_px: of hallucinations near the joint.
        other: see LogDensities.
    """
    anywhere = _log_density(residual_px, covariance_px2, scale_px, lambda squared: -1.5 * np.log1p(squared))
    return np.logaddexp(np.log(1 - _OTHER_JOINT_SHARE) + anywhere, np.log(_OTHER_JOINT_SHARE) + other)


def hidden_information(
    length_m: Float[np.ndarray, "frame camera joint"],
    spread_m: Float[np.ndarray, "*#frame camera"],
    config: VisibilityConfig,
) -> Float[np.ndarray, "frame camera joint"]:
    """Of the detection of a hidden joint, relative to that of a visible one; 0 where not seen.

    It is near the joint (a Cauchy distribution), unless it is of another one. The weight is that of
    expectation-maximisation for Student's distribution (Lange, Little and Taylor 1989): with one degree of freedom in
    two dimensions, 3 / (1 + d^2) at a distance of d scales.

    Args:
        length_m: of the residual, at the joint; NaN where not seen.
        spread_m: of visible detections of each camera.
        config: the priors.
    """
    relative = (CORRELATED_FACTOR * spread_m[..., None] / config.hallucinated_m) ** 2
    return np.nan_to_num((1 - _OTHER_JOINT_SHARE) * 3 / (1 + (length_m / config.hallucinated_m) ** 2) * relative)


@lru_cache(maxsize=16)  # asked for at every update of the online estimator
def _share_of_others(skeleton: Skeleton) -> Float[np.ndarray, "joint joint"]:
    """How likely each other joint is detected in the place of a hidden one."""
    n = skeleton.n_joints
    shares = np.full((n, n), 1.0 / max(n - 1, 1))
    for joint, mirrored in ((a, b) for pair in skeleton.left_right for a, b in (pair, pair[::-1])):
        shares[joint] *= 1 - _MIRRORED_SHARE
        shares[joint, mirrored] += _MIRRORED_SHARE
    np.fill_diagonal(shares, 0.0)
    return shares


def _log_density(
    residual_px: Float[np.ndarray, "*points 2"],
    covariance_px2: Float[np.ndarray, "*points 2 2"],
    scale_px: Float[np.ndarray, "*points"],
    radial: Callable[[np.ndarray], np.ndarray],
) -> Float[np.ndarray, "*points"]:
    """Of an elliptical distribution."""
    x, y, variance_px2 = residual_px[..., 0], residual_px[..., 1], scale_px**2
    xx, yy = covariance_px2[..., 0, 0] + variance_px2, covariance_px2[..., 1, 1] + variance_px2
    xy = covariance_px2[..., 0, 1]
    determinant = xx * yy - xy * xy
    # Rounding errors next to a camera may give less than is possible.
    squared = np.maximum((yy * x * x - 2 * xy * x * y + xx * y * y) / determinant, 0.0)
    return radial(squared) - 0.5 * np.log(np.maximum(determinant, variance_px2**2))


def _inverse(matrices: Float[np.ndarray, "*shape 2 2"]) -> Float[np.ndarray, "*shape 2 2"]:
    """In closed form: numpy.linalg.inv takes several times as long for so many."""
    adjugate = np.empty_like(matrices)
    adjugate[..., 0, 0], adjugate[..., 1, 1] = matrices[..., 1, 1], matrices[..., 0, 0]
    adjugate[..., 0, 1], adjugate[..., 1, 0] = -matrices[..., 0, 1], -matrices[..., 1, 0]
    determinant = matrices[..., 0, 0] * matrices[..., 1, 1] - matrices[..., 0, 1] * matrices[..., 1, 0]
    return adjugate / determinant[..., None, None]
