"""Covariances of the online estimator: those of the graph, scaled and widened for errors that the graph does not
model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from fgpose.config import Config
from fgpose.estimation.factors.projection import detection_information
from fgpose.estimation.few_view_errors import widened
from fgpose.estimation.frame_state import FrameState
from fgpose.estimation.noise import with_correlated_errors
from fgpose.estimation.running_errors import RunningErrors
from fgpose.estimation.uncertainty import distrust_factor_online, with_swing
from fgpose.estimation.variance_components import TIMES_S
from fgpose.geometry.camera import CameraRig


def online_covariance_m2(
    state: FrameState,
    linear_m2: Float[np.ndarray, "active_joint 3 3"],
    unseen_s: Float[np.ndarray, " joint"],
    step_s: float,
    errors: RunningErrors,
    rig: CameraRig,
    config: Config,
) -> Float[np.ndarray, "joint 3 3"]:
    """Covariance of every joint of a frame; NaN where it is not estimated.

    The lagged pose is treated like the newest one, though the frames after it are known, as in batch.

    Args:
        state: the frame.
        linear_m2: marginal covariances in the graph.
        unseen_s: time to when any camera sees each joint.
        step_s: usual time from frame to frame.
        errors: of the detections and of the cameras, as learned so far.
        rig: the cameras.
        config: all parameters.
    """
    skeleton = state.observations.skeleton
    covariance_m2 = np.full((skeleton.n_joints, 3, 3), np.nan)
    if state.joints:
        variances = errors.components.variances[state.joints].copy()
        variances[:, -1] *= state.evidence.bias_share[0, state.joints]
        information = _frame_information(state, rig, config)
        correlated_m2 = with_correlated_errors(linear_m2, information, step_s, variances, TIMES_S)
        factor = distrust_factor_online(_probable_weight(state), state.gathered.total_weight[0])
        covariance_m2[state.joints] = factor[state.joints, None, None] * correlated_m2
        covariance_m2 += errors.of_cameras_m2(state.evidence, state.positions_m, rig)
    covariance_m2, positions_m = covariance_m2[None], state.positions_m[None]
    lasting = errors.components.lasting
    widened_m2 = widened(covariance_m2, state.evidence, positions_m, lasting, rig, skeleton)
    swing = unseen_s[None], skeleton, config.swing, widened_m2 - covariance_m2
    return with_swing(widened_m2, positions_m, *swing, doubt=1 - state.evidence.credible)[0]


def _probable_weight(state: FrameState) -> Float[np.ndarray, " joint"]:
    """As Evidence.total_weight, of the detections that are of their joint."""
    return replace(state.gathered, weights=state.gathered.weights * state.evidence.visibility).total_weight[0]


def _frame_information(state: FrameState, rig: CameraRig, config: Config) -> Float[np.ndarray, "active_joint 3 3"]:
    """Of the detections of this frame alone."""
    joints, evidence = state.joints, state.evidence
    detections = evidence.undistorted_px[:, :, joints], evidence.detection_sigma_px[:, :, joints]
    points_m = state.positions_m[None, joints]
    return detection_information(rig, *detections, points_m, config.projection)[0]
