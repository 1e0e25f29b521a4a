"""The factors of one frame in the online estimator: its own, and those to the frame before."""

from __future__ import annotations

import gtsam
import numpy as np
from jaxtyping import Bool, Float

from fgpose.config import Config
from fgpose.estimation.bone_lengths import RunningLengths
from fgpose.estimation.factors.kinds import factors_of
from fgpose.estimation.factors.motion import Motions
from fgpose.estimation.frame_state import FrameState
from fgpose.estimation.keys import position_key, velocity_key
from fgpose.estimation.segment import Predecessor, Segment
from fgpose.geometry.camera import CameraRig
from fgpose_factors import freeze


def segment_of(
    state: FrameState, rig: CameraRig, lengths: RunningLengths, density: Float[np.ndarray, " joint"], config: Config
) -> Segment:
    """A frame in the window as a segment, from which factors are made; density: see process_noise."""
    is_first = not np.isfinite(state.step_s)
    return Segment(
        rig=rig,
        skeleton=state.observations.skeleton,
        config=config,
        evidence=state.trusted,
        active=state.active[None],
        lengths_m=lengths.median_m(),
        length_sigma_m=lengths.sigma_m(),
        process_density=density[None],
        lengths_known=True,
        initial_m=state.positions_m[None],
        before=None if is_first else Predecessor(state.at.time_s - state.step_s, state.linked),
        first_frame=state.at.frame,
    )


def own_factors(segment: Segment, state: FrameState) -> gtsam.NonlinearFactorGraph:
    """All factors of a frame but those to the frame before."""
    graph, (values, _) = gtsam.NonlinearFactorGraph(), variables(state, state.active, segment.config)
    for factors in factors_of(segment):
        if not isinstance(factors, Motions):
            for factor in factors.graph_factors(segment.keys):
                # No Python callback may be left in iSAM2.
                graph.add(freeze(factor, values) if isinstance(factor, gtsam.CustomFactor) else factor)
    return graph


def link_factors(segment: Segment) -> gtsam.NonlinearFactorGraph:
    """The motion from the frame before, if there is one."""
    graph = gtsam.NonlinearFactorGraph()
    for motions in Motions.of(segment):
        for factor in motions.graph_factors(segment.keys):
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
