"""The bias of the detections of each joint in each camera: an error that is the same in every frame.

Networks place a joint beside where bones and other views have it, and calibrations are off by centimetres. If such an
error is taken for noise, a joint jumps whenever a camera ceases to see it. With the mean residual m_c of a joint in
camera c and its mean Jacobian J_c, in metres at the joint,

    m_c = J_c d + b_c + e_c,    b_c ~ N(0, s_c^2),    e_c ~ N(0, spread^2 / n + timing^2),

where d is by how much the joint itself would have to move. Nothing is known of d beforehand, so that what all cameras
have in common is no bias, but an error of the joint. The variances s_c^2 are re-estimated from the biases (MacKay 1992,
Bayesian interpolation), and shrunk by ratios towards what is usual: a camera that was moved after its calibration has
larger ones than the others.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from fgpose.estimation.noise import LEAST_SPREAD_M, MEMORY_S, shrunk
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.reprojection import linearized_projection

# What is usual counts as so many well-determined biases, for all cameras and for one against all; each camera has two
# for each joint.
_PRIOR_BIASES = 4.0
USUAL_M = 0.01
"""Standard deviation along each axis of the image that is usual; BlazePose and OpenPose have 9 to 12 mm on a recording
(fgpose_benchmarks.synthetic.real_errors), calibrations add theirs."""
_TURNS = 10  # of the re-estimation: three times as many change no error on the tuning clips of the benchmark by 0.1 %
_LEAST_MEASUREMENTS = 1.0
_EVERY_S = 0.5  # it takes half a millisecond, and biases change slowly
# Information on d, 1/m^2: keeps it finite where one camera is alone, and is nothing beside any detection.
_NEXT_TO_NOTHING = 1e-2


class Bias(NamedTuple):
    """Of the detections of each joint in each camera."""

    bias_m: Float[np.ndarray, "camera joint 2"]
    """Along the axes of the image, in metres at the joint; 0 where nothing is known of it."""
    common_share: Float[np.ndarray, " joint"]
    """Variance of d, which is what biases do to the joint, in that which it would have if all cameras were as bad as
    they are on average: of one bad camera the others know. 1 where nothing is known."""

    @staticmethod
    def none(n_cameras: int, n_joints: int) -> Bias:
        return Bias(np.zeros((n_cameras, n_joints, 2)), np.ones(n_joints))


@dataclass(frozen=True, eq=False)
class ResidualSums:
    """Sums over frames for each joint in each camera, weighted by how many independent measurements its detections
    are."""

    measurements: Float[np.ndarray, "camera joint"]
    offset_m: Float[np.ndarray, "camera joint 2"]
    """Of the detections from the projected joint, along the axes of the image."""
    jacobian: Float[np.ndarray, "camera joint 2 3"]
    """Of the projection, along the same axes, by the position of the joint."""
    timing_m2: Float[np.ndarray, "camera joint"]
    """Variance of errors that come from the times of the images; the same in consecutive frames."""

    @staticmethod
    def none(n_cameras: int, n_joints: int) -> ResidualSums:
        shape = n_cameras, n_joints
        return ResidualSums(np.zeros(shape), np.zeros((*shape, 2)), np.zeros((*shape, 2, 3)), np.zeros(shape))

    @staticmethod
    def of(
        measured_px: Float[np.ndarray, "frame camera joint 2"],
        positions_m: Float[np.ndarray, "frame joint 3"],
        measurements: Float[np.ndarray, "frame camera joint"],
        timing_m: Float[np.ndarray, "frame joint"],
        rig: CameraRig,
    ) -> ResidualSums:
        """Of the detections of some frames.

        Args:
            measured_px: undistorted, moved to the time of their frame; NaN where there is none.
            positions_m: the pose; NaN where a joint is not estimated.
            measurements: how many independent measurements of its joint each detection is.
            timing_m: error that comes from the time of the images.
            rig: the cameras.
        """
        residual_px, jacobian, known = linearized_projection(measured_px, rig, positions_m)
        count = np.where(known, measurements, 0.0)
        per_px = np.divide(count, rig.px_per_m(positions_m), out=np.zeros_like(count), where=known)
        return ResidualSums(
            measurements=count.sum(axis=0),
            offset_m=-np.einsum("tcj,tcji->cji", per_px, residual_px),
            jacobian=np.einsum("tcj,tcjia->cjia", per_px, jacobian),
            timing_m2=np.sum(count * timing_m[:, None] ** 2, axis=0),
        )

    def plus(self, earlier: ResidualSums, keep: float) -> ResidualSums:
        """With earlier ones, which count less by this factor."""
        return ResidualSums(**{name: own + keep * getattr(earlier, name) for name, own in vars(self).items()})

    def bias(self, spread_m: Float[np.ndarray, " camera"]) -> Bias:
        """The most probable biases.

        Args:
            spread_m: standard deviation of the detections of each camera but for the bias.
        """
        enough = self.measurements >= _LEAST_MEASUREMENTS
        n = np.where(enough, self.measurements, 1.0)
        mean_m, jacobian = self.offset_m / n[..., None], self.jacobian / n[..., None, None]
        noise_m2 = (spread_m[:, None] ** 2 + self.timing_m2) / n
        variance_m2, bias_m = np.full(len(n), USUAL_M**2), np.zeros_like(mean_m)
        for _ in range(_TURNS):
            precision = np.where(enough, 1 / (variance_m2[:, None] + noise_m2), 0.0)
            covariance_m2, weighted = _of_moves(precision, jacobian)
            moved_m = np.einsum("jab,cjib,cji->ja", covariance_m2, weighted, mean_m)
            share = variance_m2[:, None] * precision
            bias_m = share[..., None] * (mean_m - np.einsum("cjia,ja->cji", jacobian, moved_m))
            common = np.einsum("cjia,jab,cjib->cj", weighted, covariance_m2, jacobian)
            determined = np.sum(share * (2 - common), axis=1)
            determined = np.maximum(determined, 1e-9)
            own_m2 = np.maximum(np.sum(bias_m**2, axis=(1, 2)) / determined, LEAST_SPREAD_M**2)
            of_all_m2 = np.exp(np.average(np.log(own_m2), weights=determined))
            usual_m2 = shrunk(of_all_m2, determined.sum(), USUAL_M**2, _PRIOR_BIASES)
            variance_m2 = shrunk(own_m2, determined, usual_m2, _PRIOR_BIASES)
        of_known_m2, of_mean_m2 = (
            np.trace(_of_moves(np.where(enough, 1 / of_camera_m2[:, None], 0.0), jacobian)[0], axis1=-2, axis2=-1)
            for of_camera_m2 in (variance_m2, np.full_like(variance_m2, variance_m2.mean()))
        )
        several = enough.sum(axis=0) >= 2
        return Bias(bias_m, np.where(several, np.minimum(of_known_m2 / of_mean_m2, 1.0), 1.0))


def _of_moves(
    precision: Float[np.ndarray, "camera joint"], jacobian: Float[np.ndarray, "camera joint 2 3"]
) -> tuple[Float[np.ndarray, "joint 3 3"], Float[np.ndarray, "camera joint 2 3"]]:
    """Covariance of d, if the mean residuals have this precision, 1/m^2; and the weighted Jacobians."""
    weighted = precision[..., None, None] * jacobian
    information = np.einsum("cjia,cjib->jab", weighted, jacobian) + _NEXT_TO_NOTHING * np.eye(3)
    return np.linalg.inv(information), weighted


class RunningBias:
    """The biases learned frame by frame; earlier frames have less weight."""

    bias: Bias
    """Learned so far."""

    def __init__(self, n_cameras: int, n_joints: int) -> None:
        self.bias = Bias.none(n_cameras, n_joints)
        self._sums, self._since_s = ResidualSums.none(n_cameras, n_joints), 0.0

    def add(self, sums: ResidualSums, step_s: float, spread_m: Float[np.ndarray, " camera"]) -> None:
        """Take the next frame, this time after the one before."""
        self._sums = sums.plus(self._sums, keep=float(np.exp(-step_s / MEMORY_S)))
        self._since_s += step_s
        if self._since_s >= _EVERY_S:
            self.bias, self._since_s = self._sums.bias(spread_m), 0.0
