"""Covariances of the online estimator: those of the graph, with errors and motion as they are in the recording, and
widened for what the graph does not model."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from fgpose.config import Config
from fgpose.estimation.covariances.few_view_errors import told_apart, widened
from fgpose.estimation.covariances.filter_response import FilterResponse, filter_responses, index_of_gain
from fgpose.estimation.covariances.joints_alone import Directions, InGraph
from fgpose.estimation.covariances.other_side import (
    SteadyDistances,
    may_have_crossed,
    off_across,
    other_side_m2,
    sole_rays,
)
from fgpose.estimation.covariances.roughness import NewestPose, RunningRoughness
from fgpose.estimation.covariances.running_errors import (
    RunningErrors,
    WhitenedViews,
    information_by_axis,
    whitened,
)
from fgpose.estimation.covariances.uncertainty import LEAST_FACTOR, distrust_factor_online, with_swing
from fgpose.estimation.covariances.variance_components import LONGEST_STEP_S, TIMES_S
from fgpose.estimation.factors.projection import detection_information
from fgpose.estimation.frame_state import FrameState
from fgpose.estimation.noise import LEARNED_EVERY_S, surely_positive
from fgpose.estimation.process_noise import NEARBY_S
from fgpose.geometry.camera import CameraRig
from fgpose.skeleton import Skeleton

_LEAST_STEP_S = 1e-4  # no camera is faster


class OnlineCovariances:
    """Of the frames of one estimator, with what it has learned of errors and motion so far."""

    def __init__(self, n_cameras: int, skeleton: Skeleton, config: Config) -> None:
        self.errors, self.roughness = RunningErrors(n_cameras, skeleton.joints), RunningRoughness()
        self._config, self._information = config, np.zeros((skeleton.n_joints, 2, 3, 3))
        self._unlearned_s = 0.0
        self._distances = SteadyDistances(skeleton.n_joints)
        self._least_off = np.full(skeleton.n_joints, np.inf)
        """off_across of each joint when it was least since two cameras saw it, until _sides_s."""
        self._sides_s = -np.inf
        self._speed_mps = 0.0
        """Of the body, when a camera saw it last."""

    def learn(self, oldest: FrameState, rig: CameraRig) -> None:
        """From a frame that is one lag old."""
        evidence, positions_m = oldest.evidence, oldest.positions_m
        self._unlearned_s = self._unlearned_s + oldest.step_s if np.isfinite(oldest.step_s) else 0.0
        if self._unlearned_s >= LEARNED_EVERY_S:
            views = whitened(evidence, positions_m, rig)
            self.errors.add(evidence, positions_m, views, self._unlearned_s, rig)
            by_axis = information_by_axis(views[1])[0]
            # A joint that was seen until now is filtered as if it still were.
            seen = by_axis.any(axis=(1, 2, 3))[:, None, None, None]
            keep = np.where(seen, np.exp(-self._unlearned_s / NEARBY_S), 1.0)
            self._information = keep * self._information + (1 - keep) * by_axis
            self._unlearned_s = 0.0
            self._distances.learn(positions_m[None], told_apart(evidence, oldest.observations.skeleton))
        if evidence.observed.any():
            self._speed_mps = float(np.linalg.norm(oldest.velocities_mps[evidence.observed[0]].mean(axis=0)))
        self.roughness.compare(oldest.at.frame, positions_m, evidence.observed[0] & oldest.active)

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
        linear_m2, views = surely_positive(linear_m2), whitened(state.evidence, state.positions_m, rig)
        directions, newest, _, difference = self._responses(state, linear_m2, views, step_s, rig)
        in_graph = InGraph.of(directions, newest.steady, linear_m2)
        if self.roughness.is_wanted(state.at.frame, state.at.time_s):
            self.roughness.note(state.at.frame, state.at.time_s, self._newest_pose(state, in_graph, difference))
        return self._covariance_m2(state, linear_m2, views, in_graph, newest, unseen_s, rig)

    def _newest_pose(self, state: FrameState, in_graph: InGraph, difference: FilterResponse) -> NewestPose:
        """With its difference from the lagged one."""
        noise_m2, motion_m2 = np.full((2, len(state.active)), np.nan)
        noise_m2[state.joints] = np.trace(self._noise_m2(state, in_graph, difference), axis1=-2, axis2=-1)
        motion_m2[state.joints] = np.trace(in_graph.motion_m2(difference), axis1=-2, axis2=-1)
        noise_m2[~state.evidence.observed[0]] = np.nan
        return NewestPose(state.positions_m, noise_m2, motion_m2)

    def of_lagged_m2(
        self,
        state: FrameState,
        linear_m2: Float[np.ndarray, "active_joint 3 3"],
        unseen_s: Float[np.ndarray, " joint"],
        step_s: float,
        rig: CameraRig,
    ) -> Float[np.ndarray, "joint 3 3"]:
        """The same of a frame of which the next ones are known."""
        linear_m2, views = surely_positive(linear_m2), whitened(state.evidence, state.positions_m, rig)
        directions, _, smoothed, _ = self._responses(state, linear_m2, views, step_s, rig)
        in_graph = InGraph.of(directions, smoothed.steady, linear_m2)
        return self._covariance_m2(state, linear_m2, views, in_graph, smoothed, unseen_s, rig)

    def _responses(
        self,
        state: FrameState,
        linear_m2: Float[np.ndarray, "active_joint 3 3"],
        views: WhitenedViews,
        step_s: float,
        rig: CameraRig,
    ) -> tuple[Directions, FilterResponse, FilterResponse, FilterResponse]:
        """Of the newest pose, the smoothed one and their difference, along each direction, to errors as large as in
        this frame; at first, when a frame alone tells more than in a steady state, as if motion were that fast."""
        step_s = float(np.clip(step_s, _LEAST_STEP_S, LONGEST_STEP_S))
        joints, model = state.joints, self._config.motion.model
        of_frame, learned = _frame_information(state, rig, self._config), self._information[joints]
        is_new = ~learned.any(axis=(1, 2, 3))
        learned[is_new] = of_frame[is_new, None] / 2
        directions = Directions.of(learned)
        added_m2 = state.process_density[joints] * step_s ** (3 if model == "constant_velocity" else 1)
        of_graph = np.trace(np.linalg.inv(linear_m2), axis1=-2, axis2=-1)
        gain = np.trace(of_frame, axis1=-2, axis2=-1) / of_graph
        at_first_m2 = index_of_gain(gain) ** 2 / directions.information.mean(axis=-1)
        index = np.sqrt(np.maximum(added_m2, at_first_m2)[:, None] * directions.information)
        responses = filter_responses(index, step_s, TIMES_S, model, self._shared(state)[:, None])
        size = self.errors.size_in(state.evidence, state.positions_m, views, rig)
        newest, smoothed, difference = (replace(each, noise=size * each.noise) for each in responses)
        return directions, newest, smoothed, difference

    def _shared(self, state: FrameState) -> Float[np.ndarray, " active_joint"]:
        """Correlation of the errors of each joint with those of its neighbours, on average."""
        neighbours = _neighbours(state.observations.skeleton)
        shared = np.sum(neighbours * self.errors.components.correlation, axis=1)
        return np.clip(shared, 0.0, 1.0)[state.joints]

    def _noise_m2(
        self, state: FrameState, in_graph: InGraph, response: FilterResponse
    ) -> Float[np.ndarray, "active_joint 3 3"]:
        components = self.errors.components
        variances = components.variances[state.joints].copy()
        variances[:, -1] *= state.evidence.bias_share[0, state.joints]
        noise = np.einsum("jkc,jc->jk", response.noise, variances)
        # Where one camera alone sees a joint, bones do more than to average its errors.
        shared = self._shared(state) * state.evidence.observed[0, state.joints]
        return in_graph.noise_m2(noise, components.axes[state.joints], shared)

    def _covariance_m2(
        self,
        state: FrameState,
        linear_m2: Float[np.ndarray, "active_joint 3 3"],
        views: WhitenedViews,
        in_graph: InGraph,
        response: FilterResponse,
        unseen_s: Float[np.ndarray, " joint"],
        rig: CameraRig,
    ) -> Float[np.ndarray, "joint 3 3"]:
        skeleton, evidence = state.observations.skeleton, state.evidence
        covariance_m2 = np.full((skeleton.n_joints, 3, 3), np.nan)
        if state.joints:
            of_motion_m2 = in_graph.motion_m2(response) + in_graph.excess_m2
            found_m2 = self._noise_m2(state, in_graph, response) + self.roughness.value * of_motion_m2
            found_m2 += LEAST_FACTOR * linear_m2
            distrust = distrust_factor_online(_probable_weight(state), state.gathered.total_weight[0])[state.joints]
            covariance_m2[state.joints] = distrust[:, None, None] * found_m2
            covariance_m2 += self.errors.of_cameras_m2(evidence, state.positions_m, views[1], rig)
        covariance_m2, positions_m = covariance_m2[None], state.positions_m[None]
        lasting = self.errors.components.lasting
        widened_m2 = widened(covariance_m2, evidence, positions_m, lasting, rig, skeleton, self._distances)
        widened_m2 = widened_m2 + self._other_side_m2(state, widened_m2, rig)
        swing = unseen_s[None], skeleton, self._config.swing, widened_m2 - covariance_m2
        return with_swing(widened_m2, positions_m, *swing, 1 - evidence.credible, self._speed_mps)[0]

    def _other_side_m2(
        self, state: FrameState, covariance_m2: Float[np.ndarray, "1 joint 3 3"], rig: CameraRig
    ) -> Float[np.ndarray, "1 joint 3 3"]:
        """Of joints that one camera alone sees."""
        evidence, positions_m, skeleton = state.evidence, state.positions_m[None], state.observations.skeleton
        ray = sole_rays(evidence, positions_m, rig)
        if state.at.time_s > self._sides_s:
            self._sides_s = state.at.time_s
            self._least_off[evidence.observed[0]] = np.inf
        if not ray.any():
            return np.zeros_like(covariance_m2)
        if state.at.time_s == self._sides_s:
            self._least_off = np.minimum(self._least_off, off_across(ray, positions_m, covariance_m2, skeleton)[0])
        share = may_have_crossed(self._least_off)[None] * ray.any(axis=-1)
        return other_side_m2(share, ray, positions_m, skeleton)


@lru_cache(maxsize=16)  # asked for at every update
def _neighbours(skeleton: Skeleton) -> Float[np.ndarray, "joint joint"]:
    """Share of each joint in those that bones join to another one."""
    joined = np.zeros((skeleton.n_joints, skeleton.n_joints))
    for start, end in skeleton.bones:
        joined[start, end] = joined[end, start] = 1.0
    return joined / np.maximum(joined.sum(axis=1, keepdims=True), 1.0)


def _probable_weight(state: FrameState) -> Float[np.ndarray, " joint"]:
    """As Evidence.total_weight, of the detections that are of their joint."""
    probable = state.gathered.weights * state.evidence.visibility
    return np.where(state.gathered.detected, probable, 0.0)[0].sum(axis=0)


def _frame_information(state: FrameState, rig: CameraRig, config: Config) -> Float[np.ndarray, "active_joint 3 3"]:
    """Of the detections of this frame alone."""
    joints, evidence = state.joints, state.evidence
    detections = evidence.undistorted_px[:, :, joints], evidence.detection_sigma_px[:, :, joints]
    points_m = state.positions_m[None, joints]
    return detection_information(rig, *detections, points_m, config.projection)[0]
