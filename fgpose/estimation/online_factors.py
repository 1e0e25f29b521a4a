"""The factors of one frame in the online estimator: its own, and those to the frame before."""

from __future__ import annotations

from collections.abc import Iterator

import gtsam
import numpy as np
from jaxtyping import Bool, Float

from fgpose.config import Config, MotionConfig
from fgpose.estimation import frame_factors
from fgpose.estimation.bone_lengths import RunningLengths
from fgpose.estimation.frame_state import FrameState
from fgpose.estimation.keys import position_key, velocity_key
from fgpose.geometry.camera import CameraRig
from fgpose_factors import freeze


def own_factors(
    state: FrameState,
    rig: CameraRig,
    lengths: RunningLengths,
    density: Float[np.ndarray, " joint"],
    config: Config,
) -> gtsam.NonlinearFactorGraph:
    """All factors of a frame but those to the frame before; density: see process_noise."""
    graph = gtsam.NonlinearFactorGraph()
    for factors in (
        _of_detections(state, rig, config),
        _of_bones(state, lengths, config),
        _of_velocities_and_priors(state, density, config),
    ):
        for factor in factors:
            graph.add(factor)
    return graph


def link_factors(
    before: FrameState | None, state: FrameState, density: Float[np.ndarray, " joint"], config: MotionConfig
) -> gtsam.NonlinearFactorGraph:
    """The motion from the frame before, if there is one."""
    graph = gtsam.NonlinearFactorGraph()
    if before is None:
        return graph
    joints = np.flatnonzero(state.linked).tolist()
    for factor in frame_factors.motion_factors(before.at, state.at, joints, density, config):
        graph.add(factor)
    return graph


def variables(state: FrameState, which: Bool[np.ndarray, " joint"], config: Config) -> tuple[gtsam.Values, list[int]]:
    """First guesses of these joints, and their keys."""
    values, keys = gtsam.Values(), []
    for joint in np.flatnonzero(which).tolist():
        keys.append(position_key(joint, state.at.frame))
        values.insert(keys[-1], state.positions_m[joint])
        if config.motion.model == "constant_velocity":
            keys.append(velocity_key(joint, state.at.frame))
            values.insert(keys[-1], state.velocities_mps[joint])
    return values, keys


def _of_detections(state: FrameState, rig: CameraRig, config: Config) -> Iterator[gtsam.NonlinearFactor]:
    frame, evidence, active = state.at.frame, state.evidence, state.active
    detections = evidence.undistorted_px[0], evidence.weights[0]
    yield from frame_factors.projection_factors(rig, frame, *detections, active, config.projection)
    anchored = evidence.anchored[0] & active
    yield from frame_factors.anchor_factors(frame, anchored, evidence.guess_m[0], config.fusion)
    depths = evidence.views_m[0], evidence.rays[0], evidence.depth_sigma_m[0]
    yield from frame_factors.depth_factors(frame, state.step_s, active, *depths, config.depth)


def _of_bones(state: FrameState, lengths: RunningLengths, config: Config) -> Iterator[gtsam.NonlinearFactor]:
    skeleton, frame, active = state.observations.skeleton, state.at.frame, state.active
    if config.symmetry.form == "frame":
        values, _ = variables(state, active, config)
        for factor in frame_factors.symmetry_factors(skeleton, frame, active, config.symmetry):
            yield freeze(factor, values)
    elif config.symmetry.form == "shared_length":
        known = lengths.median_m(), np.hypot(config.symmetry.sigma_m, lengths.sigma_m())
        yield from frame_factors.known_length_factors(skeleton, frame, active, state.positions_m, *known)


def _of_velocities_and_priors(
    state: FrameState, density: Float[np.ndarray, " joint"], config: Config
) -> Iterator[gtsam.NonlinearFactor]:
    skeleton, frame, seen = state.observations.skeleton, state.at.frame, state.evidence.seen[0]
    if np.isfinite(state.step_s):
        yield from frame_factors.fading_factors(
            skeleton, frame, state.step_s, state.active, seen, density, config.motion
        )
    entering = np.flatnonzero(state.active & ~state.linked).tolist()
    with_velocity = config.motion.model == "constant_velocity"
    yield from frame_factors.prior_factors(
        frame, entering, state.positions_m, config.prior, with_velocity=with_velocity
    )
