"""Whether each detection is of its joint or hallucinated, as a hidden state.

A robust kernel judges every detection by itself. But a network hallucinates an occluded joint for as long as the
occluder stays. So each joint in each camera has a state, visible or hidden, which is a Markov chain in time. Evidence
is the residual against the present pose, and the weight that the detection had before (evidence.weights). The
posterior multiplies the information of the detection; pose and posterior are found by turns (as in
expectation-maximisation, in fgpose.estimation.smoother).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from fgpose.config import Config, VisibilityConfig
from fgpose.estimation.evidence.detection_bias import Bias, ResidualSums, RunningBias
from fgpose.estimation.evidence.evidence import PROBABLE, Evidence
from fgpose.estimation.noise import CORRELATION_S, correlated_frames
from fgpose.estimation.visibility.agreement import Agreement, is_doubtful
from fgpose.estimation.visibility.detection_residuals import (
    LEAST_SPREAD_M,
    PRIOR_MEASUREMENTS_OF_CAMERA,
    DetectionResiduals,
    hidden_information,
    spread_m_of,
    with_spread,
)
from fgpose.estimation.visibility.visibility_chain import Chain, Stays
from fgpose.geometry.camera import CameraRig
from fgpose.sampling import usual_step_s
from fgpose.skeleton import Skeleton

# Residuals of consecutive frames count as one measurement within twice this time. Chosen on the tuning clips of the
# benchmark, standard family: from 0.01 to 0.06 s the mean errors there differ by less than 3 %.
_CORRELATION_S = 0.02
# The estimate of a fast joint lags behind, and images are not taken at the time that they state: the residual of a
# visible joint may be as much larger as it moves in this time. At 0.02 s two occluded cameras lose 1 %, at 0 they lose
# 2 %, and a runner's ankles are taken for hallucinated.
_TIMING_S = 0.01
# Online, the spread follows a camera that is moved within some seconds.
_SPREAD_MEMORY_S = 10.0
# 1 / (2 f), with the density f of the logarithm of the length of a normal error at its median, ln 2.
_MEDIAN_GAIN = 0.72
# Logarithm of the odds from which online a place off the predicted path is believed on which three views agree: nothing
# later takes it back. At 0 the mean error of the newest pose on the tuning clips of the benchmark, occluded, is 3 %
# larger.
_SURE_ONLINE = 4.0
_LEAST_STEP_S = 1e-6  # a camera that is there twice at one time tells nothing new


def judged(
    evidence: Evidence,
    positions_m: Float[np.ndarray, "frame joint 3"],
    rig: CameraRig,
    skeleton: Skeleton,
    config: Config,
    before: Float[np.ndarray, "frame camera joint"] | None = None,
) -> Evidence:
    """The evidence with what a pose tells about it: the probability that each detection is of its joint (forward-
    backward algorithm), and biases, standard deviations and weights that follow.

    Args:
        evidence: of all frames, its detections moved to the time of their frame (evidence.delays), with the
            weights of the fusion and the standard deviations with which the pose was found.
        positions_m: the pose as estimated so far; NaN where a joint is not estimated.
        rig: cameras of the evidence.
        skeleton: for the mirrored joints.
        config: robust kernel, motion model and the priors.
        before: the probability that an earlier turn gave; how long joints stay visible or hidden, and the biases, are
            learned from it.
    """
    priors, step_s, chain = config.visibility, _steps_s(evidence.time_s), Chain(config.visibility)
    moved_m = _moved_m(_speed_mps(positions_m, evidence.time_s))
    if before is not None:
        chain = Chain(priors, Stays.of(before, step_s, evidence.detected))
        if priors.bias == "constant":
            sums = _residual_sums(evidence, before, step_s, positions_m, moved_m, rig)
            bias = sums.bias(spread_m_of(evidence, rig.px_per_m(positions_m)))
            evidence = evidence.less_bias(positions_m, bias, rig)
    residuals = DetectionResiduals.of(positions_m, evidence, rig, config)
    spread_m = residuals.spread_m(priors.sigma_m, float(np.median(_independent(step_s, CORRELATION_S))))
    spread_of_joint_m = np.hypot(spread_m[:, None], moved_m[:, None])
    said = Agreement.of(residuals, spread_of_joint_m, spread_m, chain.usual, 0.0, rig, skeleton, priors)
    odds = said.log_odds * _independent(step_s, _CORRELATION_S)[:, None, None]
    probability = chain.smoothed(chain.filtered(odds, step_s), odds, step_s)
    evidence = replace(evidence, off_path_m=said.off_path_m)
    return _known(evidence, *residuals.of_seen, spread_m, probability, step_s[:, None, None], priors)


@dataclass(frozen=True, eq=False)
class _Known:
    """What the images of each camera tell."""

    probability: Float[np.ndarray, "camera joint"]
    """That each joint is visible in the last."""
    last_s: Float[np.ndarray, "camera 1"]
    """When that was taken."""
    spread_m: Float[np.ndarray, " camera"]
    measurements: Float[np.ndarray, " camera"]
    """From which that was learned, as far as they count still."""

    def since_s(self, evidence: Evidence) -> Float[np.ndarray, "camera 1"]:
        """Time from the last image of each camera to a frame."""
        return np.maximum(evidence.time_s[0] - self.last_s, _LEAST_STEP_S)


class Filtered(NamedTuple):
    """What a frame and those before it tell."""

    time_s: float
    """Of the frame."""
    probability: Float[np.ndarray, "camera joint"]
    """That each joint is visible to each camera."""


class RunningVisibility:
    """The same online: forward for the newest frame, forward and backward for the window, the spread of each camera
    from the last seconds.

    What a pose tells about its frame is known after the solver has run. So it weights the detections of the next frame,
    and those of the window when that is judged again.
    """

    def __init__(self, n_cameras: int, skeleton: Skeleton, config: Config) -> None:
        self._skeleton, self._config = skeleton, config
        self._stays, self._chain = Stays(), Chain(config.visibility)
        self._on = config.visibility.model == "markov"
        self._probability = np.full((n_cameras, skeleton.n_joints), self._chain.usual if self._on else 1.0)
        self._last_s = np.full((n_cameras, 1), -np.inf)
        self._spread_m = np.full(n_cameras, config.visibility.sigma_m)
        self._measurements = np.zeros(n_cameras)
        self._newest_s, self._before_newest = -np.inf, self._known_of_images()
        self._bias = RunningBias(n_cameras, skeleton.n_joints)
        self._oldest: Evidence | None = None
        self.at_first = Filtered(-np.inf, self._probability)
        """Before there is any frame."""

    @property
    def probability(self) -> Float[np.ndarray, "camera joint"]:
        """That each joint is visible to each camera, when that last took an image."""
        return self._probability

    @property
    def bias(self) -> Bias:
        """Learned so far."""
        return self._bias.bias

    def _known_of_images(self) -> _Known:
        """As they are; no array of them changes."""
        return _Known(self._probability, self._last_s, self._spread_m, self._measurements)

    def _known_before(self, evidence: Evidence) -> _Known:
        """What the images before those of a frame tell, which is the newest or a new one."""
        return self._before_newest if evidence.time_s[0] == self._newest_s else self._known_of_images()

    def add(
        self,
        positions_m: Float[np.ndarray, "joint 3"],
        velocities_mps: Float[np.ndarray, "joint 3"],
        evidence: Evidence,
        rig: CameraRig,
        has_image: Bool[np.ndarray, " camera"],
    ) -> None:
        """Take the pose of the newest frame and its detections, or take it again where another image has joined it:
        the first image of a frame is judged when there is another to compare it with."""
        if not self._on:
            return
        before = self._known_before(evidence)
        self._newest_s, self._before_newest = float(evidence.time_s[0]), before
        self._spread_m, self._measurements = before.spread_m, before.measurements
        residuals = DetectionResiduals.of(positions_m[None], evidence, rig, self._config)
        since_s = before.since_s(evidence)
        odds = self._log_odds(residuals, velocities_mps[None], rig)[0] * _independent(since_s, _CORRELATION_S)
        updated = self._chain.updated(self._chain.predicted(before.probability, since_s), odds)
        self._probability = np.where(has_image[:, None], updated, before.probability)
        self._last_s = np.where(has_image[:, None], evidence.time_s[0], before.last_s)
        self._learn_spread(since_s, residuals, has_image)

    def judged(
        self,
        evidence: Evidence,
        positions_m: Float[np.ndarray, "frame joint 3"],
        velocities_mps: Float[np.ndarray, "frame joint 3"],
        rig: CameraRig,
        before: Filtered,
    ) -> tuple[Evidence, Float[np.ndarray, "frame camera joint"]]:
        """The evidence of the newest frames, with what their poses tell about it (see the function of this name), and
        the filtered probabilities; before is of the frame before them."""
        if not self._on:
            return evidence, evidence.visibility
        residuals = DetectionResiduals.of(positions_m, evidence, rig, self._config)
        step_s = np.diff(evidence.time_s, prepend=before.time_s)
        odds = self._log_odds(residuals, velocities_mps, rig) * _independent(step_s, _CORRELATION_S)[:, None, None]
        filtered = self._chain.filtered(odds, step_s, before.probability)
        probability = self._chain.smoothed(filtered, odds, step_s)
        seen, priors = residuals.of_seen, self._config.visibility
        return _known(evidence, *seen, self._spread_m, probability, step_s[:, None, None], priors), filtered

    def marginalise(
        self,
        oldest: Evidence,
        positions_m: Float[np.ndarray, "joint 3"],
        velocities_mps: Float[np.ndarray, "joint 3"],
        rig: CameraRig,
    ) -> None:
        """The oldest frame leaves the window. Take the next one, as it was judged last, with its weights as gathered:
        biases, and how long joints stay visible or hidden, are learned from it."""
        if not self._on:
            return
        before, self._oldest = self._oldest, oldest
        if before is None:
            return
        step_s, detected = oldest.time_s - before.time_s, np.concatenate([before.detected, oldest.detected])
        visibility = np.concatenate([before.visibility, oldest.visibility])
        stays = Stays.of(visibility, np.append(np.inf, step_s), detected)
        self._stays = self._stays.then(stays, float(step_s[0]))
        self._chain = Chain(self._config.visibility, self._stays)
        if self._config.visibility.bias == "constant":
            moved_m = _moved_m(np.linalg.norm(velocities_mps, axis=-1))
            sums = _residual_sums(oldest, oldest.visibility, step_s, positions_m[None], moved_m[None], rig)
            self._bias.add(sums, float(step_s[0]), self._spread_m)

    def _log_odds(
        self, residuals: DetectionResiduals, velocities_mps: Float[np.ndarray, "frame joint 3"], rig: CameraRig
    ) -> Float[np.ndarray, "frame camera joint"]:
        moved_m = _moved_m(np.linalg.norm(velocities_mps, axis=-1))
        spread_m = np.hypot(self._spread_m[:, None], moved_m[:, None])
        return np.where(residuals.several, self._said(residuals, spread_m, rig).log_odds, 0.0)

    def _said(
        self, residuals: DetectionResiduals, visible_m: Float[np.ndarray, "#frame camera #joint"], rig: CameraRig
    ) -> Agreement:
        given, priors = (residuals, visible_m, self._spread_m, self._chain.usual), self._config.visibility
        return Agreement.of(*given, _SURE_ONLINE, rig, self._skeleton, priors)

    def _learn_spread(
        self,
        since_s: Float[np.ndarray, "camera 1"],
        residuals: DetectionResiduals,
        has_image: Bool[np.ndarray, " camera"],
    ) -> None:
        """Robbins and Monro's estimate of the weighted median that the batch takes."""
        tells = residuals.tells[0] & has_image[:, None]
        measurements = np.where(tells, _independent(since_s, CORRELATION_S) * residuals.weights[0], 0.0)
        keep = np.where(has_image, np.exp(-since_s[:, 0] / _SPREAD_MEMORY_S), 1.0)
        self._measurements = keep * self._measurements + measurements.sum(axis=1)
        larger = np.sum(measurements * np.sign(residuals.single_spread_m[0] - self._spread_m[:, None]), axis=1)
        logs = _MEDIAN_GAIN * larger / (PRIOR_MEASUREMENTS_OF_CAMERA + self._measurements)
        self._spread_m = np.maximum(self._spread_m * np.exp(logs), LEAST_SPREAD_M)

    def with_image(
        self,
        is_own: Bool[np.ndarray, " camera"],
        filtered: Filtered,
        before: Filtered,
        judged: Evidence,
        evidence: Evidence,
        positions_m: Float[np.ndarray, "joint 3"],
        rig: CameraRig,
    ) -> Evidence:
        """The evidence of an older frame that another image joins; what was known of its other detections stays.

        Args:
            is_own: whose image it is.
            filtered, before: of this frame, and of the one before it.
            judged: without the image, as it is in the graph.
            evidence: with the image, as gathered.
            positions_m: the pose.
            rig: the cameras.
        """
        if not self._on:
            return evidence
        probability = np.where(is_own[:, None], filtered.probability, judged.visibility[0])
        since_s = np.full((len(probability), 1), max(filtered.time_s - before.time_s, _LEAST_STEP_S))
        return self._with_probability(probability[None], evidence, positions_m, rig, since_s)

    def predicted(self, evidence: Evidence, positions_m: Float[np.ndarray, "joint 3"], rig: CameraRig) -> Evidence:
        """The evidence of the next frame, or of the newest that another image joins, with what is known of it before
        it is solved.

        Args:
            evidence: of the frame.
            positions_m: the predicted pose.
            rig: the cameras.
        """
        if not self._on:
            return evidence
        before = self._known_before(evidence)
        since_s = before.since_s(evidence)
        probability = self._chain.predicted(before.probability, since_s)
        if is_doubtful(positions_m, evidence.undistorted_px[0], self._spread_m, rig):
            residuals = DetectionResiduals.of(positions_m[None], evidence, rig, self._config)
            said = self._said(residuals, self._spread_m[None, :, None], rig)
            is_off = np.isfinite(said.off_path_m[0]).all(axis=-1)
            probability = np.where(is_off, self._chain.updated(probability, said.log_odds[0]), probability)
            evidence = replace(evidence, off_path_m=said.off_path_m)
        return self._with_probability(probability[None], evidence, positions_m, rig, since_s)

    def _with_probability(
        self,
        probability: Float[np.ndarray, "1 camera joint"],
        evidence: Evidence,
        positions_m: Float[np.ndarray, "joint 3"],
        rig: CameraRig,
        since_s: Float[np.ndarray, "camera 1"],
    ) -> Evidence:
        px_per_m = rig.px_per_m(positions_m)[None]
        length_m = np.linalg.norm(rig.project(positions_m) - evidence.undistorted_px, axis=-1) / px_per_m
        return _known(evidence, length_m, px_per_m, self._spread_m, probability, since_s, self._config.visibility)


def _residual_sums(
    evidence: Evidence,
    visibility: Float[np.ndarray, "frame camera joint"],
    step_s: Float[np.ndarray, " frame"],
    positions_m: Float[np.ndarray, "frame joint 3"],
    moved_m: Float[np.ndarray, "frame joint"],
    rig: CameraRig,
) -> ResidualSums:
    """Of the detections that are probably of their joints."""
    probable = np.where(visibility > PROBABLE, visibility * evidence.weights, 0.0)
    measurements = _independent(step_s, CORRELATION_S)[:, None, None] * probable
    return ResidualSums.of(evidence.measured_px, positions_m, measurements, moved_m, rig)


def _known(
    evidence: Evidence,
    length_m: Float[np.ndarray, "frame camera joint"],
    px_per_m: Float[np.ndarray, "frame camera joint"],
    spread_m: Float[np.ndarray, " camera"],
    probability: Float[np.ndarray, "frame camera joint"],
    step_s: Float[np.ndarray, "*steps"],
    config: VisibilityConfig,
) -> Evidence:
    """The evidence with this probability of visible, and the standard deviations and weights that follow from it."""
    hidden = hidden_information(length_m, spread_m, config)
    known = replace(with_spread(evidence, spread_m, px_per_m), visibility=probability)
    return known.trusted(_share(probability, evidence.weights, hidden, step_s))


def _share(
    probability: Float[np.ndarray, "frame camera joint"],
    weights: Float[np.ndarray, "frame camera joint"],
    hidden: Float[np.ndarray, "frame camera joint"],
    step_s: Float[np.ndarray, "*steps"],
) -> Float[np.ndarray, "frame camera joint"]:
    """Share of its weight that a detection should have if it is of a visible joint with this probability. A hidden one
    tells where the joint is too: little (hidden_information), and the same for as long as errors are correlated."""
    of_frame = hidden * _independent(step_s, CORRELATION_S)
    return np.minimum(probability + (1 - probability) * of_frame / weights, 1.0)


def _speed_mps(
    positions_m: Float[np.ndarray, "frame joint 3"], time_s: Float[np.ndarray, " frame"]
) -> Float[np.ndarray, "frame joint"]:
    """NaN where it is not known."""
    if len(time_s) < 2:
        return np.full(positions_m.shape[:2], np.nan)
    return np.linalg.norm(np.gradient(positions_m, time_s, axis=0), axis=-1)


def _moved_m(speed_mps: Float[np.ndarray, "*joints"]) -> Float[np.ndarray, "*joints"]:
    """How much a joint moves in _TIMING_S; 0 where its speed is not known."""
    return _TIMING_S * np.nan_to_num(speed_mps)


def _steps_s(time_s: Float[np.ndarray, " frame"]) -> Float[np.ndarray, " frame"]:
    """Time since the frame before; for the first frame, the usual one, inf if it is alone."""
    return np.concatenate([[usual_step_s(time_s)], np.diff(time_s)])


def _independent(step_s: Float[np.ndarray, "*frames"], correlation_s: float) -> Float[np.ndarray, "*frames"]:
    """How much of an independent measurement each frame is when errors are correlated over this time."""
    return np.asarray(1.0 / correlated_frames(step_s, correlation_s))
