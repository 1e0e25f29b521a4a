"""Covariances of the online estimator: those of the graph, with errors and motion as they are in the recording, and
widened for what the graph does not model."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from fgpose.config import Config
from fgpose.estimation.covariances.few_view_errors import widened
from fgpose.estimation.covariances.filter_response import FilterResponse, filter_responses, index_of_gain
from fgpose.estimation.covariances.roughness import NewestPose, RunningRoughness
from fgpose.estimation.covariances.running_errors import RunningErrors
from fgpose.estimation.covariances.uncertainty import LEAST_FACTOR, distrust_factor_online, with_swing
from fgpose.estimation.covariances.variance_components import LONGEST_STEP_S, TIMES_S
from fgpose.estimation.factors.projection import detection_information
from fgpose.estimation.frame_state import FrameState
from fgpose.estimation.noise import surely_positive
from fgpose.estimation.process_noise import NEARBY_S
from fgpose.geometry.camera import CameraRig
from fgpose.skeleton import Skeleton

_LEAST_STEP_S = 1e-4  # no camera is faster
_ERRORS_EVERY_S = 0.03  # errors are correlated over 0.15 s and more: frames between tell hardly anything new of them


class OnlineCovariances:
    """Of the frames of one estimator, with what it has learned of errors and motion so far."""

    def __init__(self, n_cameras: int, n_joints: int, config: Config) -> None:
        self.errors, self.roughness = RunningErrors(n_cameras, n_joints), RunningRoughness()
        self._config, self._information = config, np.zeros(n_joints)
        self._unlearned_s = 0.0

    def learn(self, oldest: FrameState, information: Float[np.ndarray, " joint"], rig: CameraRig) -> None:
        """From a frame that is one lag old, with the information of its detections."""
        evidence, positions_m = oldest.evidence, oldest.positions_m
        self._unlearned_s = self._unlearned_s + oldest.step_s if np.isfinite(oldest.step_s) else 0.0
        if self._unlearned_s >= _ERRORS_EVERY_S:
            self.errors.add(evidence, positions_m, self._unlearned_s, rig)
            self._unlearned_s = 0.0
        self.roughness.compare(oldest.at.frame, positions_m, evidence.observed[0] & oldest.active, oldest.step_s)
        # A joint that was seen until now is filtered as if it still were.
        keep = np.where(information > 0, np.exp(-oldest.step_s / NEARBY_S), 1.0)
        self._information = keep * self._information + (1 - keep) * information

    def of_newest_m2(
        self,
        state: FrameState,
        linear_m2: Float[np.ndarray, "active_joint 3 3"],
        unseen_s: Float[np.ndarray, " joint"],
        step_s: float,
        rig: CameraRig,
    ) -> Float[np.ndarray, "joint 3 3"]:
        """Covariance of every joint of the newest frame; NaN where it is not estimated.

        Args:
            state: the frame.
            linear_m2: marginal covariances in the graph.
            unseen_s: time to when any camera sees each joint.
            step_s: usual time from frame to frame.
            rig: the cameras.
        """
        newest, _, difference = self._responses(state, linear_m2, step_s, rig)
        newest = newest.beyond(self._excess(state, linear_m2, newest))
        of_joint_m2, noise_m2, motion_m2 = np.full((3, len(state.active)), np.nan)
        of_joint_m2[state.joints] = np.trace(linear_m2, axis1=-2, axis2=-1)
        noise_m2[state.joints], motion_m2[state.joints] = self._noise(state, difference), difference.motion
        noise_m2[~state.evidence.observed[0]] = np.nan
        pose = NewestPose(state.positions_m, of_joint_m2 * noise_m2, of_joint_m2 * motion_m2)
        self.roughness.note(state.at.frame, pose)
        return self._covariance_m2(state, linear_m2, newest, unseen_s, rig)

    def of_lagged_m2(
        self,
        state: FrameState,
        linear_m2: Float[np.ndarray, "active_joint 3 3"],
        unseen_s: Float[np.ndarray, " joint"],
        step_s: float,
        rig: CameraRig,
    ) -> Float[np.ndarray, "joint 3 3"]:
        """The same of a frame of which the next ones are known."""
        _, smoothed, _ = self._responses(state, linear_m2, step_s, rig)
        smoothed = smoothed.beyond(self._excess(state, linear_m2, smoothed))
        return self._covariance_m2(state, linear_m2, smoothed, unseen_s, rig)

    def _responses(
        self, state: FrameState, linear_m2: Float[np.ndarray, "active_joint 3 3"], step_s: float, rig: CameraRig
    ) -> tuple[FilterResponse, FilterResponse, FilterResponse]:
        """Of the newest pose, the smoothed one and their difference; at first, when a frame alone tells more than in a
        steady state, as if motion were that fast."""
        step_s = float(np.clip(step_s, _LEAST_STEP_S, LONGEST_STEP_S))
        joints, model = state.joints, self._config.motion.model
        added_m2 = state.process_density[joints] * step_s ** (3 if model == "constant_velocity" else 1)
        index = np.sqrt(added_m2 * self._information[joints])
        alone = np.trace(_frame_information(state, rig, self._config), axis1=-2, axis2=-1)
        of_graph = np.trace(np.linalg.inv(surely_positive(linear_m2)), axis1=-2, axis2=-1)
        index, shared = np.maximum(index, index_of_gain(alone / of_graph)), self._shared(state)
        return filter_responses(index, step_s, TIMES_S, model, shared[joints])

    def _shared(self, state: FrameState) -> Float[np.ndarray, " joint"]:
        """Correlation of the errors of each joint with those of its neighbours, on average."""
        neighbours = _neighbours(state.observations.skeleton)
        return np.clip(np.sum(neighbours * self.errors.components.correlation, axis=1), 0.0, 1.0)

    def _excess(
        self, state: FrameState, linear_m2: Float[np.ndarray, "active_joint 3 3"], response: FilterResponse
    ) -> Float[np.ndarray, " active_joint"]:
        """How many times the variance of each joint is what it is in a steady state."""
        steady = self._information[state.joints] / (3 * response.steady)
        return np.fmax(np.trace(linear_m2, axis1=-2, axis2=-1) * steady, 1.0)

    def _noise(self, state: FrameState, response: FilterResponse) -> Float[np.ndarray, " active_joint"]:
        variances = self.errors.components.variances[state.joints].copy()
        variances[:, -1] *= state.evidence.bias_share[0, state.joints]
        return np.sum(response.noise * variances, axis=1)

    def _covariance_m2(
        self,
        state: FrameState,
        linear_m2: Float[np.ndarray, "active_joint 3 3"],
        response: FilterResponse,
        unseen_s: Float[np.ndarray, " joint"],
        rig: CameraRig,
    ) -> Float[np.ndarray, "joint 3 3"]:
        skeleton, evidence = state.observations.skeleton, state.evidence
        covariance_m2 = np.full((skeleton.n_joints, 3, 3), np.nan)
        if state.joints:
            factor = self._noise(state, response) + self.roughness.value * response.motion
            distrust = distrust_factor_online(_probable_weight(state), state.gathered.total_weight[0])[state.joints]
            factor = distrust * np.maximum(factor, LEAST_FACTOR)
            covariance_m2[state.joints] = factor[:, None, None] * surely_positive(linear_m2)
            covariance_m2 += self.errors.of_cameras_m2(evidence, state.positions_m, rig)
        covariance_m2, positions_m = covariance_m2[None], state.positions_m[None]
        lasting = self.errors.components.lasting
        widened_m2 = widened(covariance_m2, evidence, positions_m, lasting, rig, skeleton)
        swing = unseen_s[None], skeleton, self._config.swing, widened_m2 - covariance_m2
        return with_swing(widened_m2, positions_m, *swing, doubt=1 - evidence.credible)[0]


@lru_cache(maxsize=16)  # asked for at every update
def _neighbours(skeleton: Skeleton) -> Float[np.ndarray, "joint joint"]:
    """Share of each joint in those that bones join to another one."""
    joined = np.zeros((skeleton.n_joints, skeleton.n_joints))
    for start, end in skeleton.bones:
        joined[start, end] = joined[end, start] = 1.0
    return joined / np.maximum(joined.sum(axis=1, keepdims=True), 1.0)


def _probable_weight(state: FrameState) -> Float[np.ndarray, " joint"]:
    """As Evidence.total_weight, of the detections that are of their joint."""
    return replace(state.gathered, weights=state.gathered.weights * state.evidence.visibility).total_weight[0]


def _frame_information(state: FrameState, rig: CameraRig, config: Config) -> Float[np.ndarray, "active_joint 3 3"]:
    """Of the detections of this frame alone."""
    joints, evidence = state.joints, state.evidence
    detections = evidence.undistorted_px[:, :, joints], evidence.detection_sigma_px[:, :, joints]
    points_m = state.positions_m[None, joints]
    return detection_information(rig, *detections, points_m, config.projection)[0]
