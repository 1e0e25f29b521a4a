"""The bias of the detections of each joint in each camera: an error that is the same in every frame.

Networks place a joint beside where bones and other views have it, and calibrations are off by centimetres. If such an
error is taken for noise, a joint jumps whenever a camera ceases to see it. With the mean residual m_cj of a joint in a
camera and its mean Jacobian J_cj, in metres at the joint,

    m_cj = J_cj d_j + s_c + b_cj + e_cj,
    s_c ~ N(0, S_c^2),    b_cj ~ N(0, v_c^2),    e_cj ~ N(0, spread^2 / n + timing^2),

where d_j is by how much the joint itself would have to move, and s_c what all joints have in common in a camera that is
not where the calibration has it. Nothing is known of d beforehand, so that what all cameras have in common is no bias,
but an error of the joint. How large S and v are is weighed by the evidence for some hypotheses (MacKay 1992, Bayesian
interpolation): all cameras alike, or one that was moved, or that is worse than the others. The result is the mean over
the hypotheses (Hoeting et al. 1999, Bayesian model averaging).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.estimation.noise import MEMORY_S
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.reprojection import linearized_projection

# Standard deviations along each axis of the image: of the detector's biases, of which so much is usual (BlazePose and
# OpenPose have 9 to 12 mm on a recording, fgpose_benchmarks.synthetic.real_errors), within so many factors of e; and of
# what calibrations add, in steps of a factor of three, within which estimates of so few numbers are known.
_BIASES_M, _USUAL_M, _FACTORS = (0.001, 0.003, 0.008, 0.02, 0.05), 0.01, 1.0
_SHIFTS_M = (0.0005, 0.002, 0.005, 0.012, 0.03)
# One camera that has moved, by so much; or whose detections are so many times as bad. And how probable each is, and
# what the calibration adds to the others.
_MOVED_M, _TIMES_WORSE, _PROBABILITY = (0.05, 0.2), (3.0, 10.0), 0.01
_OTHERS_M = (0.001, 0.005)
_NEGLIGIBLE = 1e-4
_LEAST_MEASUREMENTS = 1.0
_EVERY_S = 0.5  # it takes some milliseconds, and biases change slowly
# Information on d, 1/m^2: keeps it finite where one camera is alone, and is nothing beside any detection.
_NEXT_TO_NOTHING = 1e-2


@dataclass(frozen=True, eq=False)
class _Hypotheses:
    """How large the biases of each camera are."""

    variance_m2: Float[np.ndarray, "size camera"]
    """Of the biases of joints."""
    size: Int[np.ndarray, " hypothesis"]
    """Which of these."""
    shift_m2: Float[np.ndarray, "hypothesis camera"]
    """Variance of what all joints have in common."""
    log_probability: Float[np.ndarray, " hypothesis"]
    """Before anything is measured."""

    @staticmethod
    @lru_cache(maxsize=8)
    def of(n_cameras: int) -> _Hypotheses:
        sizes_m2, rows, nobody = [], [], [(0, 0.0)]
        one = np.log(_PROBABILITY / 2)  # two sizes of either
        alike = list(product(_SHIFTS_M, nobody))
        moved = list(product(_OTHERS_M, product(range(n_cameras), _MOVED_M)))
        for bias_m in _BIASES_M:
            usual = -0.5 * (np.log(bias_m / _USUAL_M) / _FACTORS) ** 2
            worse = product(range(n_cameras), _TIMES_WORSE) if bias_m in _BIASES_M[1:-1] else []
            for camera, times in [(0, 1.0), *worse]:
                sizes_m2.append(np.where(np.arange(n_cameras) == camera, times * bias_m, bias_m) ** 2)
                for shift_m, (other, moved_m) in [*alike, *moved] if times == 1 else alike[1:2]:
                    own_m = np.where(np.arange(n_cameras) == other, max(moved_m, shift_m), shift_m)
                    rows.append((len(sizes_m2) - 1, own_m**2, usual + (one if moved_m or times > 1 else 0.0)))
        size, shift_m2, log_probability = zip(*rows, strict=True)
        return _Hypotheses(np.array(sizes_m2), np.array(size), np.array(shift_m2), np.array(log_probability))

    def only(self, kept: Bool[np.ndarray, " hypothesis"]) -> _Hypotheses:
        """Some of them."""
        return replace(
            self, size=self.size[kept], shift_m2=self.shift_m2[kept], log_probability=self.log_probability[kept]
        )


class Bias(NamedTuple):
    """Of the detections of each joint in each camera."""

    bias_m: Float[np.ndarray, "camera joint 2"]
    """Along the axes of the image, in metres at the joint; 0 where nothing is known of it."""
    common_share: Float[np.ndarray, " joint"]
    """Variance of d, which is what biases do to the joint, in that which it would have if all cameras were as bad as
    they are on average: of one bad camera the others know. 1 where nothing is known."""
    covariance_m2: Float[np.ndarray, "joint 3 3"]
    """Of what cameras that stand wrong do to d; 0 where nothing is known."""

    @staticmethod
    def none(n_cameras: int, n_joints: int) -> Bias:
        return Bias(np.zeros((n_cameras, n_joints, 2)), np.ones(n_joints), np.zeros((n_joints, 3, 3)))


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
        """The biases, on average over the hypotheses.

        Args:
            spread_m: standard deviation of the detections of each camera but for the bias.
        """
        enough = self.measurements >= _LEAST_MEASUREMENTS
        if not (enough.sum(axis=0) >= 2).any():
            return Bias.none(*enough.shape)
        n = np.where(enough, self.measurements, 1.0)
        mean_m, jacobian = self.offset_m / n[..., None], self.jacobian / n[..., None, None]
        noise_m2 = (spread_m[:, None] ** 2 + self.timing_m2) / n
        hypotheses = _Hypotheses.of(len(n))
        total_m2 = hypotheses.variance_m2[:, :, None] + noise_m2
        moves = _Moves.of(mean_m, jacobian, np.where(enough, 1 / total_m2, 0.0))
        shifts = _Shifts.of(hypotheses, mean_m, jacobian, total_m2, enough)
        share = np.where(enough, hypotheses.variance_m2[:, :, None] / total_m2, 0.0)
        return _mean_over(shifts, moves, jacobian, share, enough)


@dataclass(frozen=True, eq=False)
class _Moves:
    """By how much the joints would have to move, for each size of biases."""

    moved_m: Float[np.ndarray, "size joint 3"]
    """d, if no camera is shifted."""
    covariance_m2: Float[np.ndarray, "size joint 3 3"]
    """Of it."""
    by_shift: Float[np.ndarray, "size joint 3 view"]
    """By how much d is less for a shift along one axis of the image of one camera."""
    by_view: Float[np.ndarray, "size joint 3 view"]
    """The pull of such a shift on the joint: times the covariance, by_shift."""
    left_m: Float[np.ndarray, "size camera joint 2"]
    """What is left of the residuals."""

    @staticmethod
    def of(
        mean_m: Float[np.ndarray, "camera joint 2"],
        jacobian: Float[np.ndarray, "camera joint 2 3"],
        precision: Float[np.ndarray, "size camera joint"],
    ) -> _Moves:
        weighted = precision[..., None, None] * jacobian
        information = np.einsum("kcjia,cjib->kjab", weighted, jacobian) + _NEXT_TO_NOTHING * np.eye(3)
        covariance_m2 = np.linalg.inv(information)
        by_view = weighted.transpose(0, 2, 4, 1, 3).reshape(*information.shape[:3], -1)
        by_shift = covariance_m2 @ by_view
        moved_m = by_shift @ mean_m.transpose(1, 0, 2).reshape(mean_m.shape[1], -1)[..., None]
        left_m = mean_m - np.einsum("cjia,kja->kcji", jacobian, moved_m[..., 0])
        return _Moves(moved_m[..., 0], covariance_m2, by_shift, by_view, left_m)


@dataclass(frozen=True, eq=False)
class _Shifts:
    """By how much all joints are shifted in each camera, for each hypothesis that is probable."""

    hypotheses: _Hypotheses
    mean_m: Float[np.ndarray, "hypothesis view"]
    covariance_m2: Float[np.ndarray, "hypothesis view view"]
    probability: Float[np.ndarray, " hypothesis"]

    @staticmethod
    def of(
        hypotheses: _Hypotheses,
        mean_m: Float[np.ndarray, "camera joint 2"],
        jacobian: Float[np.ndarray, "camera joint 2 3"],
        total_m2: Float[np.ndarray, "size camera joint"],
        enough: Bool[np.ndarray, "camera joint"],
    ) -> _Shifts:
        """With the mean Jacobian of each camera, which tells no shift from a move of the whole body. With the joints'
        own, small errors of another pattern, such as that of the focal length, would tell them apart, and wrongly. What
        joints have to move by themselves is taken from the residuals before."""
        precision = np.where(enough, 1 / total_m2, 0.0)
        alike = np.where(enough, 1.0, 0.0)[None]
        left_m = _Moves.of(mean_m, jacobian, alike).left_m[0]
        sums, n_joints = np.einsum("cj,cjia->cia", alike[0], jacobian), np.maximum(alike[0].sum(axis=1), 1.0)
        of_camera = np.broadcast_to((sums / n_joints[:, None, None])[:, None], jacobian.shape)
        moves = _Moves.of(left_m, of_camera, precision)
        n_views = moves.by_view.shape[-1]
        gradient = np.einsum("kcj,kcji->kci", precision, moves.left_m).reshape(-1, n_views)
        information = np.repeat(precision.sum(axis=2), 2, axis=-1)[..., None] * np.eye(n_views)
        information = information - np.einsum("kjav,kjaw->kvw", moves.by_view, moves.by_shift, optimize=True)
        # What the hypotheses differ in of the logarithm of the evidence, d and the shifts integrated out.
        of_size = -0.5 * np.einsum("kcj,kcji,cji->k", precision, moves.left_m, left_m, optimize=True)
        of_size -= np.sum(np.where(enough, np.log(total_m2), 0.0), axis=(1, 2))
        of_size += 0.5 * np.linalg.slogdet(moves.covariance_m2)[1].sum(axis=-1)
        prior = 1 / np.repeat(hypotheses.shift_m2, 2, axis=-1)
        information = information[hypotheses.size] + prior[..., None] * np.eye(n_views)
        gradient = gradient[hypotheses.size]
        shift_m = np.linalg.solve(information, gradient[..., None])[..., 0]
        evidence = of_size[hypotheses.size] + 0.5 * np.einsum("hv,hv->h", gradient, shift_m)
        evidence += 0.5 * np.log(prior).sum(axis=-1) - 0.5 * np.linalg.slogdet(information)[1]
        odds = evidence + hypotheses.log_probability
        probability = np.exp(odds - odds.max())
        kept = probability > _NEGLIGIBLE * probability.sum()
        probability = probability[kept] / probability[kept].sum()
        return _Shifts(hypotheses.only(kept), shift_m[kept], np.linalg.inv(information[kept]), probability)


def _mean_over(
    shifts: _Shifts,
    moves: _Moves,
    jacobian: Float[np.ndarray, "camera joint 2 3"],
    share: Float[np.ndarray, "size camera joint"],
    enough: Bool[np.ndarray, "camera joint"],
) -> Bias:
    """The biases over all hypotheses; of what is left of a residual this share is bias, and not noise."""
    hypotheses = shifts.hypotheses

    def by_size(values: np.ndarray) -> np.ndarray:
        sums = np.zeros((len(share), *values.shape[1:]))
        np.add.at(sums, hypotheses.size, np.einsum("h,h...->h...", shifts.probability, values))
        return sums

    of_size, shift_m = by_size(np.ones(len(shifts.probability))), by_size(shifts.mean_m)
    shift_m2 = by_size(shifts.covariance_m2 + shifts.mean_m[:, :, None] * shifts.mean_m[:, None])
    # All of a size, times its probability.
    less_m = np.einsum("kjav,kv->kja", moves.by_shift, shift_m)
    of_cameras_m = shift_m.reshape(len(share), -1, 1, 2)
    left_m = of_size[:, None, None, None] * moves.left_m + np.einsum("cjia,kja->kcji", jacobian, less_m) - of_cameras_m
    bias_m = np.sum(of_cameras_m + share[..., None] * left_m, axis=0)
    crossed_m2 = np.einsum("kja,kjb->jab", moves.moved_m, less_m)
    by_shifts_m2 = np.einsum("kjav,kvw,kjbw->jab", moves.by_shift, shift_m2, moves.by_shift, optimize=True)
    by_shifts_m2 += np.einsum("k,kja,kjb->jab", of_size, moves.moved_m, moves.moved_m, optimize=True)
    mean_m = np.einsum("k,kja->ja", of_size, moves.moved_m) - less_m.sum(axis=0)
    by_shifts_m2 -= crossed_m2 + crossed_m2.swapaxes(1, 2) + mean_m[:, :, None] * mean_m[:, None]
    by_biases_m2 = np.einsum("k,kjab->jab", of_size, moves.covariance_m2)
    of_known_m2 = np.trace(by_shifts_m2 + by_biases_m2, axis1=-2, axis2=-1)
    alike_m2 = float(np.mean(of_size @ hypotheses.variance_m2 + shifts.probability @ hypotheses.shift_m2))
    of_mean = _Moves.of(np.zeros((*enough.shape, 2)), jacobian, np.where(enough, 1 / alike_m2, 0.0)[None])
    of_mean_m2 = np.trace(of_mean.covariance_m2[0], axis1=-2, axis2=-1)
    several = enough.sum(axis=0) >= 2
    bias_m = np.where((enough & several)[..., None], bias_m, 0.0)
    common = np.where(several, np.minimum(of_known_m2 / of_mean_m2, 1.0), 1.0)
    return Bias(bias_m, common, np.where(several[:, None, None], by_shifts_m2, 0.0))


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
