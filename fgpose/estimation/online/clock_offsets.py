"""How late each camera is, learned online from the residuals of the newest frames.

Errors of detections last, and those of joints are alike, so that frames tell less than their number says. How much less
is seen by how far apart the offsets are that different seconds tell.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from fgpose.config import Config, ProjectionConfig
from fgpose.estimation.noise import CORRELATION_S, correlated_frames
from fgpose.estimation.solvers.elimination import eliminate_joints
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.changing_rig import TOGETHER_S
from fgpose.geometry.reprojection import linearized_projection
from fgpose.shown import Shown
from fgpose_factors import robust_weight

# Errors of a network last for some tenths of a second, motion changes its direction within one: seconds that follow
# each other are independent.
_SECOND_S = 1.0
_PRIOR_FREEDOM = 6.0  # of what is usual: two seconds of four cameras
_MOST_SECONDS = 100  # they tell the scatter to a tenth
_HARDLY_ANY = 1e-9  # information, 1/s^2; it is divided by
_NO_INFORMATION = 1e-6  # in that of the best known offset; that of all cameras together is never seen


@dataclass(frozen=True, eq=False, repr=False)
class OffsetEvidence(Shown):
    """What motion tells of the time offsets; that of several people adds up."""

    information: Float[np.ndarray, "camera camera"]
    """1/s^2; the joints are eliminated."""
    moment: Float[np.ndarray, " camera"]
    """Information times the offsets that fit best, 1/s."""
    squares: Float[np.ndarray, "2 camera"]
    """Of the gradients of single detections, whatever their weights, and what is expected of these, 1/s^2."""

    @staticmethod
    def nothing(n_cameras: int) -> OffsetEvidence:
        return OffsetEvidence(np.zeros((n_cameras, n_cameras)), np.zeros(n_cameras), np.zeros((2, n_cameras)))

    @property
    def misfit(self) -> Float[np.ndarray, " camera"]:
        """How many times the expected variance the detections of each camera have along the motion: more than once
        where its offset is wrong by so much that they are taken for outliers, and those that fit by chance are left."""
        return np.maximum(self.squares[0] / np.maximum(self.squares[1], _HARDLY_ANY), 1.0)

    def __add__(self, other: OffsetEvidence) -> OffsetEvidence:
        squares = self.squares + other.squares
        return OffsetEvidence(self.information + other.information, self.moment + other.moment, squares)

    def without(self, camera: int) -> OffsetEvidence:
        """What it tells of all others, whatever the offset of one is."""
        own = self.information[:, camera] / max(self.information[camera, camera], _HARDLY_ANY)
        is_own = np.arange(len(own)) == camera
        others = np.eye(len(own)) - np.outer(own, is_own)
        return OffsetEvidence(others @ self.information, others @ self.moment, np.where(is_own, 0.0, self.squares))

    def faded(self, share: float) -> OffsetEvidence:
        """With this share of its weight."""
        return OffsetEvidence(share * self.information, share * self.moment, share * self.squares)


class RunningOffsets:
    """Time offsets frame by frame, from the residuals of all frames so far; older seconds have less weight.

    Several estimators may share one: the cameras are the same, whoever moves before them.

    Args:
        rig: with the offsets known so far, the mean of the prior.
    """

    def __init__(self, rig: CameraRig, config: Config) -> None:
        self._rig, self._config = rig, config
        self.elsewhere = OffsetEvidence.nothing(rig.n_cameras)
        """Of the frames that were added in other processes."""
        self._told = self._of_second = OffsetEvidence.nothing(rig.n_cameras)
        self._seconds: deque[OffsetEvidence] = deque(maxlen=_MOST_SECONDS)
        self._second_since_s, self._scatter = -np.inf, 1.0
        self.sigma_s = np.full(rig.n_cameras, config.calibration.offset_sigma_s)
        """(C,) standard deviations of the prior; zero: held. At first that of the first camera is held and the others
        have calibration.offset_sigma_s; whoever knows the clocks better says so here."""
        self.sigma_s[:1] = 0.0
        self._newest_s = -np.inf
        self._set_by_s = np.zeros(rig.n_cameras)

    @property
    def set_by_s(self) -> Float[np.ndarray, " camera"]:
        """By how much the clock of each camera was set while others were not (ClockSteps), seconds; zero: it was not.
        What was told of it before is forgotten."""
        return self._set_by_s

    @set_by_s.setter
    def set_by_s(self, by_s: Float[np.ndarray, " camera"]) -> None:
        for c in np.flatnonzero((by_s != 0) & (self._set_by_s == 0)).tolist():
            self._told, self._of_second = self._told.without(c), self._of_second.without(c)
            self._seconds = deque((each.without(c) for each in self._seconds), maxlen=_MOST_SECONDS)
        self._set_by_s = by_s.copy()

    def go_on(self, told: OffsetEvidence, time_s: float) -> None:
        """Know what was told until a time, before any frame is added."""
        self._told, self._newest_s = told, time_s

    @property
    def evidence(self) -> OffsetEvidence:
        """Of the frames that were added here."""
        return self._told.faded(1.0 / self._scatter)

    def add(
        self,
        time_s: float,
        step_s: float,
        positions_m: Float[np.ndarray, "joint 3"],
        velocities_mps: Float[np.ndarray, "joint 3"],
        undistorted_px: Float[np.ndarray, "camera joint 2"],
        weights: Float[np.ndarray, "camera joint"],
        sigma_px: Float[np.ndarray, "camera joint"],
        rig: CameraRig,
    ) -> None:
        """Take a frame of somebody at its time, its detections moved to that time with the offsets of the rig.

        Args:
            step_s: since the frame before, of the same person.
            weights: of the detections.
            sigma_px: standard deviation of a detection of weight 1.
        """
        if not self.sigma_s.any():
            return
        residuals = _Residuals.of(positions_m[None], velocities_mps[None], undistorted_px[None], rig)
        information, gradient = residuals.equations(weights[None], sigma_px[None], self._config.projection)
        squares = residuals.squares(weights[None], sigma_px[None])
        told = OffsetEvidence(information, information @ rig.time_offsets_s - gradient, squares)
        told = told.faded(1.0 / float(correlated_frames(step_s, CORRELATION_S)))
        if abs(time_s - self._second_since_s) >= _SECOND_S:  # a clock may be set back
            self._seconds.append(self._of_second)
            self._scatter = _scatter(self._seconds)
            self._second_since_s, self._of_second = time_s, OffsetEvidence.nothing(rig.n_cameras)
        passed_s = max(time_s - self._newest_s, 0.0)
        self._newest_s = max(time_s, min(self._newest_s, time_s + _SECOND_S))
        kept = self._told.faded(float(np.exp(-passed_s / self._config.calibration.offset_memory_s)))
        self._told, self._of_second = kept + told, self._of_second + told

    @property
    def has_told(self) -> bool:
        """Whether there is any evidence, of cameras that are not held."""
        told = self.evidence.information + self.elsewhere.information
        return bool(np.diag(told)[self.sigma_s > 0].any())

    def rig(self) -> CameraRig:
        """The rig with the offsets that fit best."""
        return self._rig.with_time_offsets(self._rig.time_offsets_s + self._change_s())

    def relative(self, *, fits: bool = False) -> tuple[Float[np.ndarray, " camera"], Float[np.ndarray, " camera"]]:
        """How much later than the clocks say the images are taken, seconds, and its standard deviation. It is relative
        to the mean of the cameras by what was known of each: what all have in common cannot be seen in the motion.
        Where some are held, it is relative to these. How far a clock was set is known no better than when
        images come, to about TOGETHER_S.

        Args:
            fits: take it for granted that offsets explain what is seen. Else the standard deviation is that of White's
                covariance (Econometrica 48, 817, 1980): by the spread of the gradients as it is.
        """
        free, change_s = self.sigma_s > 0, self._change_s()
        covariance_s2 = np.zeros((len(free), len(free)))
        covariance_s2[np.ix_(free, free)] = self._covariance_s2() if fits else self._spread_s2()
        if free.all():
            weights = self.sigma_s**-2 / np.sum(self.sigma_s**-2)
            centred = np.eye(len(free)) - weights
            change_s, covariance_s2 = centred @ change_s, centred @ covariance_s2 @ centred.T
        variance_s2 = np.maximum(np.diag(covariance_s2), 0.0) + np.where(self._set_by_s != 0, TOGETHER_S**2, 0.0)
        return change_s - self._set_by_s, np.sqrt(variance_s2)

    def _change_s(self) -> Float[np.ndarray, " camera"]:
        """From the given offsets to those that fit best."""
        told, free = self.evidence + self.elsewhere, self.sigma_s > 0
        gradient = told.information @ self._rig.time_offsets_s - told.moment
        change_s = np.zeros(len(free))
        change_s[free] = -self._covariance_s2() @ gradient[free]
        return change_s

    def _spread_s2(self) -> Float[np.ndarray, "free free"]:
        """Covariance where detections have another spread than is expected of them."""
        told, free, covariance_s2 = self.evidence + self.elsewhere, self.sigma_s > 0, self._covariance_s2()
        times = np.sqrt(told.misfit)
        gradients = (told.information * times * times[:, None])[np.ix_(free, free)]
        return covariance_s2 @ (gradients + np.diag(self.sigma_s[free] ** -2)) @ covariance_s2

    def _covariance_s2(self) -> Float[np.ndarray, "free free"]:
        free = self.sigma_s > 0
        told = self.evidence.information + self.elsewhere.information
        return np.linalg.inv(told[np.ix_(free, free)] + np.diag(self.sigma_s[free] ** -2))


def _scatter(seconds: Sequence[OffsetEvidence]) -> float:
    """How many times the variance that the standard deviations of detections give is what different seconds show: the
    mean squared deviation from what all of them tell, over its degrees of freedom, drawn towards 1."""
    information, moment = (np.stack([getattr(each, name) for each in seconds]) for name in ("information", "moment"))
    own_s2, of_all_s2 = (
        np.linalg.pinv(told, rcond=_NO_INFORMATION, hermitian=True) for told in (information, information.sum(axis=0))
    )
    deviation = information @ (of_all_s2 @ moment.sum(axis=0)) - moment
    squared = np.einsum("si,sij,sj->", deviation, own_s2, deviation)
    freedom = np.einsum("sij,sji->", information, own_s2) - np.sum(information.sum(axis=0) * of_all_s2)
    return float((squared + _PRIOR_FREEDOM) / (freedom + _PRIOR_FREEDOM))


def offset_information(
    positions_m: Float[np.ndarray, "frame joint 3"],
    velocities_mps: Float[np.ndarray, "frame joint 3"],
    undistorted_px: Float[np.ndarray, "frame camera joint 2"],
    weights: Float[np.ndarray, "frame camera joint"],
    sigma_px: Float[np.ndarray, "frame camera joint"],
    rig: CameraRig,
    config: ProjectionConfig,
) -> tuple[Float[np.ndarray, "camera camera"], Float[np.ndarray, " camera"]]:
    """Gauss-Newton's information matrix (1/s^2) and gradient (1/s) of the offsets; the joints are eliminated.

    Args:
        undistorted_px: detections, moved to the times of their frames with the offsets so far.
        weights, sigma_px: of each detection, and the standard deviation that one of weight 1 would have.
        config: its kernel.
    """
    return _Residuals.of(positions_m, velocities_mps, undistorted_px, rig).equations(weights, sigma_px, config)


@dataclass(frozen=True, eq=False)
class _Residuals:
    """Of detections, and their derivatives."""

    px: Float[np.ndarray, "frame camera joint 2"]
    by_joint: Float[np.ndarray, "frame camera joint 2 3"]
    by_offset: Float[np.ndarray, "frame camera joint 2 1"]
    known: Bool[np.ndarray, "frame camera joint"]

    @staticmethod
    def of(
        positions_m: Float[np.ndarray, "frame joint 3"],
        velocities_mps: Float[np.ndarray, "frame joint 3"],
        undistorted_px: Float[np.ndarray, "frame camera joint 2"],
        rig: CameraRig,
    ) -> _Residuals:
        px, by_joint, projected = linearized_projection(undistorted_px, rig, positions_m)
        by_offset = by_joint @ velocities_mps[:, None, ..., None]
        return _Residuals(px, by_joint, by_offset, projected & np.isfinite(by_offset).all(axis=(-1, -2)))

    def equations(
        self,
        weights: Float[np.ndarray, "frame camera joint"],
        sigma_px: Float[np.ndarray, "frame camera joint"],
        config: ProjectionConfig,
    ) -> tuple[Float[np.ndarray, "camera camera"], Float[np.ndarray, " camera"]]:
        """See offset_information."""
        squared = np.where(self.known, np.sum(self.px**2, axis=-1), 0.0) / sigma_px**2
        weights = np.where(self.known, weights * robust_weight(squared, config.kernel, config.kernel_scale), 0.0)
        jacobians = np.nan_to_num(self.by_joint), np.nan_to_num(self.by_offset)
        reduced = eliminate_joints(np.nan_to_num(self.px), *jacobians, weights / sigma_px**2)
        return reduced.information, reduced.gradient

    def squares(
        self, weights: Float[np.ndarray, "frame camera joint"], sigma_px: Float[np.ndarray, "frame camera joint"]
    ) -> Float[np.ndarray, "2 camera"]:
        """See OffsetEvidence; of detections that have any weight."""
        known = self.known & (weights > 0) & np.isfinite(self.px).all(axis=-1)
        by_offset = np.where(known[..., None], self.by_offset[..., 0], 0.0) / sigma_px[..., None]
        gradient = np.sum(by_offset * np.nan_to_num(self.px) / sigma_px[..., None], axis=-1)
        return np.stack([np.sum(gradient**2, axis=(0, 2)), np.sum(by_offset**2, axis=(0, 2, 3))])
