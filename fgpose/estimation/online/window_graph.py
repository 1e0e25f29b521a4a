"""The window of the online estimator in iSAM2: the variables of its frames, and factors made from what is known of
them."""

from __future__ import annotations

from collections.abc import Mapping

import gtsam
import numpy as np
from jaxtyping import Bool, Float

from fgpose.config import Config
from fgpose.estimation.factors.kinds import factors_of
from fgpose.estimation.factors.motion import Motions
from fgpose.estimation.frame_state import FrameState
from fgpose.estimation.keys import position_key
from fgpose.estimation.online.bone_lengths import RunningLengths
from fgpose.estimation.segment import Predecessor, Segment
from fgpose.estimation.solvers.fixed_lag import FixedLagSmoother
from fgpose.frozen import changed
from fgpose.geometry.camera import CameraRig
from fgpose_factors import freeze, noise_model

_PULL_SIGMA_M = 1e-3  # for as long as it takes to linearise anew: much less than online.relinearize_m


class WindowGraph:
    """The frames of the window as variables and factors.

    The factors of some joints of a frame can be made anew from another state of it; those to the frame before stay.
    `changes` are such states, by number of the frame in the window; the joints that change are their active ones.

    Args:
        lengths: as they are learned; factors take those of the time when they are made.
        config: all parameters.
    """

    # iSAM2 eliminates anew what has changed and all that follows. Half of this changes the errors on the tuning clips
    # of the benchmark by less than 1 %.
    revised_every_s = 0.2

    def __init__(self, lengths: RunningLengths, config: Config) -> None:
        self._lengths, self._config = lengths, config
        self._smoother = FixedLagSmoother(config.online.relinearize_m)

    @property
    def repairs(self) -> int:
        """See FixedLagSmoother."""
        return self._smoother.repairs

    def add(self, state: FrameState, rig: CameraRig, changes: Mapping[int, FrameState]) -> None:
        """Take the newest frame, and change others in the same update."""
        segment = self._segment(state, rig)
        own, links = self._own_factors(segment, state), _link_factors(segment)
        self._smoother.add(own, *self._variables(state), links, self._replacements(changes, rig))

    def replace(
        self, changes: Mapping[int, FrameState], rig: CameraRig, entering: Bool[np.ndarray, " joint"] | None = None
    ) -> None:
        """Change frames; these joints of the last of them are not in the graph yet."""
        new = gtsam.Values(), list[int]()
        if entering is not None:
            new = self._variables(changed(changes[max(changes)], active=entering))
        self._smoother.replace(self._replacements(changes, rig), *new)

    def move(
        self, at: int, state: FrameState, joints: list[int], to_m: Float[np.ndarray, "joint 3"], rig: CameraRig
    ) -> None:
        """Linearise joints of a frame anew at these positions."""
        pulled = self._replacements({at: state}, rig)
        for joint in joints:
            key = position_key(joint, state.at.frame)
            pulled[at][1].add(gtsam.PriorFactorPoint3(key, to_m[joint], noise_model(3, _PULL_SIGMA_M)))
        self._smoother.replace(pulled)
        self.replace({at: state}, rig)

    def drop_oldest(self) -> None:
        """Marginalise the oldest frame."""
        self._smoother.drop_oldest()

    def read(self, state: FrameState) -> FrameState:
        """The state with the estimated values in place of the guesses."""
        positions_m, velocities_mps = np.full((len(state.active), 3), np.nan), np.zeros((len(state.active), 3))
        if self._config.motion.model == "constant_velocity":
            velocities_mps[state.active] = self._smoother.points(state.velocity_keys)
        positions_m[state.active] = self._smoother.points(state.position_keys)
        return changed(state, positions_m=positions_m, velocities_mps=velocities_mps)

    def covariances_m2(self, newest: FrameState) -> Float[np.ndarray, "active_joint 3 3"]:
        """Marginal covariance of each position of the newest frame."""
        return self._smoother.covariances(newest.position_keys)

    def lagged_covariances_m2(self, oldest: FrameState) -> Float[np.ndarray, "active_joint 3 3"]:
        """The same of the oldest frame; NaN where the window does not give it."""
        return self._smoother.oldest_covariances(oldest.position_keys)

    def _replacements(
        self, changes: Mapping[int, FrameState], rig: CameraRig
    ) -> dict[int, tuple[list[int], gtsam.NonlinearFactorGraph]]:
        """The variables in the graph, and new factors that join these alone."""
        replacements = {}
        for at, state in changes.items():
            start_m, linearized_m = state.positions_m.copy(), self._smoother.linearization_points(state.position_keys)
            start_m[state.active] = np.where(np.isnan(linearized_m), start_m[state.active], linearized_m)
            state = changed(state, positions_m=start_m)
            replacements[at] = self._keys(state), self._own_factors(self._segment(state, rig), state)
        return replacements

    def _segment(self, state: FrameState, rig: CameraRig) -> Segment:
        """The frame as a segment, from which factors are made."""
        is_first = not np.isfinite(state.step_s)
        return Segment(
            rig=rig,
            skeleton=state.observations.skeleton,
            config=self._config,
            evidence=state.evidence,
            active=state.active[None],
            lengths_m=self._lengths.learned.lengths_m,
            process_density=state.process_density[None],
            known=self._lengths.learned,
            lengths_known=True,
            initial_m=state.positions_m[None],
            before=None if is_first else Predecessor(state.at.time_s - state.step_s, state.linked),
            first_frame=state.at.frame,
        )

    def _own_factors(self, segment: Segment, state: FrameState) -> gtsam.NonlinearFactorGraph:
        """All factors of the frame but those to the frame before."""
        graph, values = gtsam.NonlinearFactorGraph(), None
        for factors in factors_of(segment):
            if not isinstance(factors, Motions):
                for factor in factors.graph_factors(segment.keys):
                    if isinstance(factor, gtsam.CustomFactor):  # no Python callback may be left in iSAM2
                        values = self._variables(state)[0] if values is None else values
                        factor = freeze(factor, values)
                    graph.add(factor)
        return graph

    def _variables(self, state: FrameState) -> tuple[gtsam.Values, list[int]]:
        """First guesses of the active joints, and their keys."""
        values, keys = gtsam.Values(), self._keys(state)
        guesses = np.concatenate([state.positions_m[state.active], state.velocities_mps[state.active]])
        for key, guess in zip(keys, guesses, strict=False):  # without velocities in the graph, those are left over
            values.insert(key, guess)
        return values, keys

    def _keys(self, state: FrameState) -> list[int]:
        """Of the positions of the active joints and, with constant velocity, of their velocities."""
        with_velocity = self._config.motion.model == "constant_velocity"
        return state.position_keys + (state.velocity_keys if with_velocity else [])


def _link_factors(segment: Segment) -> gtsam.NonlinearFactorGraph:
    """The motion from the frame before, if there is one."""
    graph = gtsam.NonlinearFactorGraph()
    for motions in Motions.of(segment):
        for factor in motions.graph_factors(segment.keys):
            graph.add(factor)
    return graph
