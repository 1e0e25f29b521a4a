"""Whether each detection is of its joint or hallucinated, as a hidden state.

A robust kernel judges every detection by itself. But a network hallucinates an occluded joint for as long as the
occluder stays. So each joint in each camera has a state, visible or hidden, which is a Markov chain in time. Evidence
is the residual against the present pose, and the weight that the detection had before (evidence.weights). The
posterior multiplies the information of the detection; pose and posterior are found by turns (as in
expectation-maximisation, in fgpose.estimation.smoother).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.config import Config, VisibilityConfig
from fgpose.estimation.evidence.detection_bias import ResidualSums
from fgpose.estimation.evidence.evidence import PROBABLE, Evidence
from fgpose.estimation.noise import CORRELATION_S, correlated_frames
from fgpose.estimation.visibility.agreement import Agreement
from fgpose.estimation.visibility.detection_residuals import DetectionResiduals, hidden_information
from fgpose.estimation.visibility.spread import graph_sigma_px, spread_m_of
from fgpose.estimation.visibility.stated_confidence import StatedConfidence
from fgpose.estimation.visibility.visibility_chain import Chain, Stays
from fgpose.frozen import changed
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.vectors import norm
from fgpose.sampling import usual_step_s
from fgpose.skeleton import Skeleton

# Residuals of consecutive frames count as one measurement within twice this time. Chosen on the tuning clips of the
# benchmark, standard family: from 0.01 to 0.06 s the mean errors there differ by less than 3 %.
RESIDUALS_CORRELATED_S = 0.02
# The estimate of a fast joint lags behind, and images are not taken at the time that they state: the residual of a
# visible joint may be as much larger as it moves in this time. At 0.02 s two occluded cameras lose 1 %, at 0 they lose
# 2 %, and a runner's ankles are taken for hallucinated.
_TIMING_S = 0.01


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
        before: the probability that an earlier turn gave; how long joints stay visible or hidden, what the confidences
            say of it, and the biases are learned from it.
    """
    priors, step_s, chain = config.visibility, _steps_s(evidence.time_s), Chain(config.visibility)
    stated = StatedConfidence.unknown(skeleton.n_joints)
    moved_m = within_timing_m(_speed_mps(positions_m, evidence.time_s))
    independently = independent(step_s, CORRELATION_S)
    if before is not None:
        chain = Chain(priors, Stays.of(before, step_s, evidence.detected))
        stated = StatedConfidence.of(evidence, before, independently[:, None, None])
        if priors.bias == "constant":
            sums = residual_sums(evidence, before, step_s, positions_m, moved_m, rig)
            bias = sums.bias(spread_m_of(evidence, rig.px_per_m(positions_m)))
            evidence = evidence.less_bias(positions_m, bias, rig)
    residuals = DetectionResiduals.of(positions_m, evidence, rig, config)
    sizes = residuals.contradictions.sizes(float(np.median(step_s)))
    spread_m = residuals.spread_m(priors.sigma_m, float(np.median(independently)), sizes)
    spread_m = np.sqrt(sizes)[:, None] * spread_m
    spread_of_joint_m = np.hypot(spread_m[..., None], moved_m[:, None])
    stated_odds = stated.log_odds(evidence)
    usual = chain.updated(chain.usual, stated_odds)
    said = Agreement.of(residuals, spread_of_joint_m, spread_m, usual, 0.0, rig, skeleton, priors)
    odds = log_odds_of_frames(said.log_odds, stated_odds, step_s[:, None, None])
    probability = chain.smoothed(chain.filtered(odds, step_s), odds, step_s)
    evidence = changed(evidence, off_path_m=said.off_path_m)
    return with_visibility(evidence, *residuals.of_seen, spread_m, probability, step_s[:, None, None], priors)


def log_odds_of_frames(
    said: Float[np.ndarray, "*frames camera joint"],
    stated: Float[np.ndarray, "*frames camera joint"],
    step_s: Float[np.ndarray, "*#steps"],
) -> Float[np.ndarray, "*frames camera joint"]:
    """What images say for visible against hidden, given those before them.

    Args:
        said, stated: what the residuals and the confidences of each alone say.
        step_s: time since the image before; a confidence stays the same for as long as the error that it is of.
    """
    return said * independent(step_s, RESIDUALS_CORRELATED_S) + stated * independent(step_s, CORRELATION_S)


def residual_sums(
    evidence: Evidence,
    visibility: Float[np.ndarray, "frame camera joint"],
    step_s: Float[np.ndarray, " frame"],
    positions_m: Float[np.ndarray, "frame joint 3"],
    moved_m: Float[np.ndarray, "frame joint"],
    rig: CameraRig,
) -> ResidualSums:
    """Of the detections that are probably of their joints."""
    probable = np.where(visibility > PROBABLE, visibility * evidence.weights, 0.0)
    measurements = independent(step_s, CORRELATION_S)[:, None, None] * probable
    return ResidualSums.of(evidence.measured_px, positions_m, measurements, moved_m, rig)


def with_visibility(
    evidence: Evidence,
    length_m: Float[np.ndarray, "frame camera joint"],
    px_per_m: Float[np.ndarray, "frame camera joint"],
    spread_m: Float[np.ndarray, "*#frame camera"],
    probability: Float[np.ndarray, "frame camera joint"],
    step_s: Float[np.ndarray, "*steps"],
    config: VisibilityConfig,
) -> Evidence:
    """The evidence with this probability of visible, and the standard deviations and weights that follow from it."""
    hidden = hidden_information(length_m, spread_m, config)
    known = changed(evidence, sigma_px=graph_sigma_px(evidence, spread_m, px_per_m), visibility=probability)
    return known.trusted(_share(probability * evidence.credible[:, None], evidence.weights, hidden, step_s))


def _share(
    probability: Float[np.ndarray, "frame camera joint"],
    weights: Float[np.ndarray, "frame camera joint"],
    hidden: Float[np.ndarray, "frame camera joint"],
    step_s: Float[np.ndarray, "*steps"],
) -> Float[np.ndarray, "frame camera joint"]:
    """Share of its weight that a detection should have if it is of a visible joint with this probability. A hidden one
    tells where the joint is too: little (hidden_information), and the same for as long as errors are correlated."""
    of_frame = hidden * independent(step_s, CORRELATION_S)
    return np.minimum(probability + (1 - probability) * of_frame / weights, 1.0)


def _speed_mps(
    positions_m: Float[np.ndarray, "frame joint 3"], time_s: Float[np.ndarray, " frame"]
) -> Float[np.ndarray, "frame joint"]:
    """NaN where it is not known."""
    if len(time_s) < 2:
        return np.full(positions_m.shape[:2], np.nan)
    return norm(np.gradient(positions_m, time_s, axis=0))


def within_timing_m(speed_mps: Float[np.ndarray, "*joints"]) -> Float[np.ndarray, "*joints"]:
    """How much a joint moves in _TIMING_S; 0 where its speed is not known."""
    return np.where(np.isnan(speed_mps), 0.0, _TIMING_S * speed_mps)


def _steps_s(time_s: Float[np.ndarray, " frame"]) -> Float[np.ndarray, " frame"]:
    """Time since the frame before; for the first frame, the usual one, inf if it is alone."""
    return np.concatenate([[usual_step_s(time_s)], np.diff(time_s)])


def independent(step_s: Float[np.ndarray, "*frames"], correlation_s: float) -> Float[np.ndarray, "*frames"]:
    """How much of an independent measurement each frame is when errors are correlated over this time."""
    return np.asarray(1.0 / correlated_frames(step_s, correlation_s))
