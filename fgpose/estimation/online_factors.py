"""The factors of one frame in the online estimator: its own, and those to the frame before."""

from __future__ import annotations

import gtsam
import numpy as np
from jaxtyping import Float

from fgpose.config import Config
from fgpose.estimation.bone_lengths import RunningLengths
from fgpose.estimation.factors.kinds import factors_of
from fgpose.estimation.factors.motion import Motions
from fgpose.estimation.frame_state import FrameState
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
        evidence=state.evidence,
        active=state.active[None],
        lengths_m=lengths.lengths_m,
        length_sigma_m=lengths.sigma_m,
        process_density=density[None],
        lengths_known=True,
        initial_m=state.positions_m[None],
        before=None if is_first else Predecessor(state.at.time_s - state.step_s, state.linked),
        first_frame=state.at.frame,
    )


def own_factors(segment: Segment, state: FrameState) -> gtsam.NonlinearFactorGraph:
    """All factors of a segment of one frame but those to the frame before."""
    graph, values = gtsam.NonlinearFactorGraph(), None
    for factors in factors_of(segment):
        if not isinstance(factors, Motions):
            for factor in factors.graph_factors(segment.keys):
                if isinstance(factor, gtsam.CustomFactor):  # no Python callback may be left in iSAM2
                    values = variables(state, segment.config)[0] if values is None else values
                    factor = freeze(factor, values)
                graph.add(factor)
    return graph


def link_factors(segment: Segment) -> gtsam.NonlinearFactorGraph:
    """The motion from the frame before, if there is one."""
    graph = gtsam.NonlinearFactorGraph()
    for motions in Motions.of(segment):
        for factor in motions.graph_factors(segment.keys):
            graph.add(factor)
    return graph


def variables(state: FrameState, config: Config) -> tuple[gtsam.Values, list[int]]:
    """First guesses of the active joints, and their keys."""
    values, keys = gtsam.Values(), keys_of(state, config)
    guesses = np.concatenate([state.positions_m[state.active], state.velocities_mps[state.active]])
    for key, guess in zip(keys, guesses, strict=False):  # without velocities in the graph, those are left over
        values.insert(key, guess)
    return values, keys


def keys_of(state: FrameState, config: Config) -> list[int]:
    """Of the positions of the active joints and, with constant velocity, of their velocities."""
    return state.position_keys + (state.velocity_keys if config.motion.model == "constant_velocity" else [])
