"""What the errors of detections, as they are, do to what the adjustment estimates: a sandwich covariance.

The adjustment weights detections as if they were independent, and so much better the fewer of them it counts. Its own
covariance is right if that is so, and if their errors are as large as its parameters say. Neither has to be: the errors
of a network are correlated over time and between joints, some last for a whole recording, and one count of independent
measurements cannot hold for poses, to which lasting errors matter, and for clocks, to which they hardly do. So the
errors are taken as they are found from what the views of each frame contradict each other by
(fgpose.estimation.covariances.variance_components). With the covariance S of the scores, the derivatives of the
objective by the unknowns at the truth, and its second derivatives H, the unknowns have the covariance H^-1 S H^-1
(Huber 1967, White 1982).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from fgpose.calibration.adjustment.problem import Bundle, BundleProblem
from fgpose.calibration.adjustment.unknowns import N_OF_CAMERA
from fgpose.estimation.covariances.detection_errors import TellingDetections
from fgpose.estimation.covariances.variance_components import (
    LONGEST_STEP_S,
    TIMES_S,
    ErrorComponents,
    correlation_after,
    covariance_of_sum,
)

# Errors of visible joints are correlated over less.
_BLOCK_S = 1.0
# Of the squares of normal errors, in their variance along each axis, 1 % are larger.
_WRONG, _NORMAL_SHARE = 9.21, 0.01


class Stretch(NamedTuple):
    """Frames of one person, one after the other."""

    n_frames: int
    step_s: float
    """From one to the next."""


def covariance_by_errors(
    problem: BundleProblem,
    state: Bundle,
    confidence: Float[np.ndarray, "frame camera joint"],
    stretches: Sequence[Stretch],
    joints: Sequence[str],
) -> Float[np.ndarray, "camera 11 camera 11"]:
    """BundleProblem.covariance with the errors that the detections have.

    Args:
        problem: without biases.
        state: near its optimum.
        confidence: of the detections.
        stretches: of the people, in the order of the frames of the problem.
        joints: names.

    Raises:
        LinAlgError: the unknowns are not determined.
    """
    terms, joints_by_shared = problem.linearized(state), problem.equations(state).joints_by_shared
    sigma_px, counted = problem.sigma_px[:, None], problem.sightings.weights
    robust = np.divide(terms.weights * sigma_px**2, counted, out=np.zeros_like(counted), where=counted > 0)
    weights = robust * confidence
    # A detection that is weighted less is taken to have a larger error.
    own_px = sigma_px / np.sqrt(np.where(weights > 0, weights, np.inf))
    in_own = np.divide(1.0, own_px, out=np.zeros_like(own_px), where=own_px > 0)
    residual, by_joint = in_own[..., None] * terms.residual_px, in_own[..., None, None] * terms.by_joint
    of_priors = problem.covariance_of_prior_scores(state)
    of_scores, of_seconds, begin = of_priors.copy(), of_priors.copy(), 0
    for stretch in stretches:
        own, begin = slice(begin, begin + stretch.n_frames), begin + stretch.n_frames
        telling = TellingDetections.of(residual[own], by_joint[own], weights[own])
        step_s = min(stretch.step_s, LONGEST_STEP_S)
        components = ErrorComponents.told_by(telling, step_s, joints)
        of_frames = np.zeros((stretch.n_frames, len(of_scores)))
        for c, columns in enumerate(problem.unknowns.columns.reshape(len(sigma_px), N_OF_CAMERA, len(of_scores))):
            by_shared = terms.by_camera[own, c] @ columns
            by_shared = by_shared - np.einsum("tjia,tjua->tjiu", terms.by_joint[own, c], joints_by_shared[own])
            pull = (terms.weights * own_px)[own, c, :, None, None] * by_shared
            of_scores += _of_errors(pull, components, step_s)
            of_frames += np.einsum("tjiu,tji->tu", pull, residual[own, c])
        of_seconds += _scatter(of_frames, step_s)
    stated, shown = problem.covariance(state, of_scores), problem.covariance(state, of_seconds)
    own, of_scatter = (np.einsum("cici->ci", each) for each in (stated, shown))
    growth = np.sqrt(np.maximum(1.0, np.divide(of_scatter, own, out=np.ones_like(own), where=own > 0)))
    grown = growth[:, :, None, None] * stated * growth
    wrong = _share_of_wrong(terms.residual_px / sigma_px[..., None], counted > 0)
    return (1 - wrong) * grown + wrong * problem.covariance(state)


def _share_of_wrong(
    in_sigmas: Float[np.ndarray, "frame camera joint 2"], used: Bool[np.ndarray, "frame camera joint"]
) -> float:
    """Of detections that are hallucinated the kernel leaves little, but as it lasts that moves the cameras, and no
    component tells how long it lasts. For their share nothing is known beyond what the adjustment counts."""
    if not used.any():
        return 0.0
    return max(float(np.mean(np.sum(in_sigmas**2, axis=-1)[used] > _WRONG)) - _NORMAL_SHARE, 0.0)


def _scatter(of_frames: Float[np.ndarray, "frame unknown"], step_s: float) -> Float[np.ndarray, "unknown unknown"]:
    """Covariance of the sum of the scores, from how those of seconds differ: what is hallucinated behind something
    lasts, and is of several joints, otherwise than the errors of visible ones."""
    second = (np.arange(len(of_frames)) * step_s / _BLOCK_S).astype(int)
    _, block = np.unique(second, return_inverse=True)
    n = int(block.max()) + 1
    sums = np.zeros((n, of_frames.shape[1]))
    np.add.at(sums, block, of_frames)
    around = sums - sums.mean(axis=0)
    return around.T @ around * n / max(n - 1, 1)


def _of_errors(
    pull: Float[np.ndarray, "frame joint 2 unknown"], components: ErrorComponents, step_s: float
) -> Float[np.ndarray, "unknown unknown"]:
    """Covariance of the sum of the errors of one camera, each times its pull."""
    n_frames, n_joints, n_axes, n_unknowns = pull.shape
    covariance = np.zeros((n_unknowns, n_unknowns))
    for time_s, variances in zip(TIMES_S, components.variances.T, strict=True):
        own = np.sqrt(variances[:, None] * components.axes)[..., None] * pull
        by_sample = np.einsum("js,tjiu->tsiu", components.mixing, own, optimize=True)
        correlation = correlation_after(time_s, np.full(n_frames, step_s))
        covariance += covariance_of_sum(by_sample.reshape(n_frames, n_joints * n_axes, n_unknowns), correlation)
    return covariance
