"""The window of the online estimator as normal equations: the solver of the batch, over the newest frames."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import islice

import numpy as np
from jaxtyping import Bool, Float

from fgpose.config import Config
from fgpose.estimation.evidence.evidence import concatenated
from fgpose.estimation.factors.state import BatchState
from fgpose.estimation.frame_state import FrameState
from fgpose.estimation.online.bone_lengths import RunningLengths
from fgpose.estimation.segment import LinkageBlocks, Marginal, Predecessor, Segment
from fgpose.estimation.solvers.block_tridiagonal import BlockTridiagonal
from fgpose.estimation.solvers.forward_pass import Conditional, ForwardPass, pose_of, unknowns_of
from fgpose.estimation.solvers.levenberg_marquardt import Search
from fgpose.estimation.solvers.normal_equations import Factorized, NormalEquations
from fgpose.frozen import changed
from fgpose.geometry.camera import CameraRig
from fgpose.sampling import TIME_ROUNDING_S

_STEPS = 2  # an update, from where the last one ended
# So many of the last seconds are solved again at each update, those before when their evidence changes. With 0.03 s,
# and with all that are revised, the errors on clips of the benchmark are the same to 1 %.
_SOLVED_S = 0.06


@dataclass(frozen=True, eq=False)
class _Eliminated:
    """A frame that follows the next one linearly."""

    state: FrameState
    marginal: Marginal | None
    """Of the frames before it."""
    conditional: Conditional


@dataclass(frozen=True, eq=False)
class _Solved:
    """What the last update has left."""

    problem: NormalEquations
    search: Search[BatchState]

    @cached_property
    def _matrix(self) -> BlockTridiagonal:
        near = self.search.undamped
        return self.problem.matrix(self.search.state, near if isinstance(near, Factorized) else None)

    @cached_property
    def forward(self) -> ForwardPass:
        """Over the frames from the first on."""
        return ForwardPass(self.problem, self.search.state, self._matrix)

    def covariances(self) -> Iterator[LinkageBlocks]:
        """See NormalEquations."""
        return self.problem.covariances(self._matrix)


class WindowEquations:
    """The newest frames, solved together at each update, and older ones of the window, which follow them. A frame that
    was eliminated is solved again, with all later ones, when its evidence changes.

    Everything is arrays: it can be copied and pickled.

    Args:
        lengths: of the bones; each update holds the present ones.
        config: all parameters.
    """

    revised_every_s = 0.1
    """At 0.04 s, when images tell anything new of what they show, the errors on the tuning clips are the same."""
    repairs = 0
    """Nothing is repaired: a step that LAPACK refuses is damped."""

    def __init__(self, lengths: RunningLengths, config: Config) -> None:
        self._lengths, self._config = lengths, config
        self._eliminated: deque[_Eliminated] = deque()
        self._frames: deque[FrameState] = deque()
        self._poses: deque[Float[np.ndarray, "kind joint 3"]] = deque()  # of those
        self._earlier_poses: list[Float[np.ndarray, " unknown"]] = []  # as far as they were read, the last one first
        self._marginal: Marginal | None = None  # of all frames before those
        self._solved: _Solved | None = None  # None where no joint is estimated

    def add(self, state: FrameState, rig: CameraRig, changes: Mapping[int, FrameState]) -> None:
        """Take the newest frame, and change others in the same update."""
        self._change(changes)
        self._frames.append(state)
        self._poses.append(self._pose(state))
        self._solve(rig)

    def replace(
        self, changes: Mapping[int, FrameState], rig: CameraRig, entering: Bool[np.ndarray, " joint"] | None = None
    ) -> None:
        """Change frames; these joints of the last of them are estimated from now on."""
        self._change(changes)
        if entering is not None:
            self._set(max(changes), changes[max(changes)].positions_m, entering)
        self._solve(rig)

    def move(
        self, at: int, state: FrameState, joints: list[int], to_m: Float[np.ndarray, "joint 3"], rig: CameraRig
    ) -> None:
        """Search anew from these positions of joints of a frame."""
        self._change({at: state})
        self._set(at, to_m, np.isin(np.arange(len(to_m)), joints))
        self._solve(rig)

    def drop_oldest(self) -> None:
        """Marginalise the oldest frame."""
        if not self._eliminated:
            self._eliminate()
        self._eliminated.popleft()

    def read(self, state: FrameState) -> FrameState:
        """The state with the estimated values in place of the guesses."""
        number = state.at.frame - self._frames[0].at.frame
        pose = self._poses[number] if number >= 0 else self._earlier_pose(-number)
        is_active = state.active[:, None]
        velocities_mps = np.where(is_active, pose[1], 0.0) if len(pose) > 1 else np.zeros_like(pose[0])
        return changed(state, positions_m=np.where(is_active, pose[0], np.nan), velocities_mps=velocities_mps)

    def _earlier_pose(self, n_before: int) -> Float[np.ndarray, "kind joint 3"]:
        """Of a frame that is so many before those that are solved."""
        known, n_kinds = self._earlier_poses, len(self._poses[0])
        while len(known) < n_before:
            next_pose = known[-1] if known else unknowns_of(self._poses[0], self._linkages)
            known.append(self._eliminated[-1 - len(known)].conditional.given(next_pose))
        return pose_of(known[n_before - 1], n_kinds, self._linkages)

    def covariances_m2(self, newest: FrameState) -> Float[np.ndarray, "active_joint 3 3"]:
        """Marginal covariance of each position of the newest frame."""
        if self._solved is None:
            return np.zeros((0, 3, 3))
        return next(self._solved.covariances()).of_positions()[newest.active]

    def lagged_covariances_m2(self, oldest: FrameState) -> Float[np.ndarray, "active_joint 3 3"]:
        """The same of the oldest frame."""
        if self._solved is None:
            return np.full((len(oldest.joints), 3, 3), np.nan)
        covariance = next(islice(self._solved.covariances(), len(self._frames) - 1, None))
        for each in reversed(self._eliminated):
            covariance = each.conditional.marginal(covariance)
        return covariance.of_positions()[oldest.active]

    def _change(self, changes: Mapping[int, FrameState]) -> None:
        """Take the evidence of frames."""
        while changes and min(changes) < len(self._eliminated):
            again = self._eliminated.pop()
            self._frames.appendleft(again.state)
            pose = again.conditional.given(unknowns_of(self._poses[0], self._linkages))
            self._poses.appendleft(pose_of(pose, len(self._poses[0]), self._linkages))
            self._marginal = again.marginal
        for at, state in changes.items():
            number = at - len(self._eliminated)
            self._frames[number] = changed(self._frames[number], evidence=state.evidence)

    def _set(self, at: int, positions_m: Float[np.ndarray, "joint 3"], joints: Bool[np.ndarray, " joint"]) -> None:
        """Estimate these joints of a frame, from these positions on."""
        number = at - len(self._eliminated)
        state = self._frames[number]
        self._frames[number] = changed(state, active=state.active | joints)
        self._poses[number] = self._poses[number].copy()
        self._poses[number][0, joints] = positions_m[joints]

    def _solve(self, rig: CameraRig) -> None:
        self._rig = rig
        poses = np.array(self._poses)
        segment, self._solved, self._earlier_poses = self._segment(poses[:, 0]), None, []
        if segment.active.any():
            problem = NormalEquations(segment)
            search = Search(problem, problem.at(poses))
            for _ in range(_STEPS):
                size = search.descend()
                if size is None or size < problem.step_tolerance:
                    break
            self._solved, self._poses = _Solved(problem, search), deque(problem.poses(search.state))
        newest_s = self._frames[-1].at.time_s
        while self._frames[0].at.time_s < newest_s - _SOLVED_S - TIME_ROUNDING_S:
            self._eliminate()

    def _eliminate(self) -> None:
        """Of the frames that are solved, the first."""
        state, pose, marginal = self._frames.popleft(), self._poses.popleft(), self._marginal
        self._earlier_poses = []
        if self._solved is None:
            self._marginal, conditional = None, Conditional.of_nobody(pose, state.observations.skeleton.linkages)
        else:
            self._marginal, conditional = self._solved.forward.eliminate()
        self._eliminated.append(_Eliminated(state, marginal, conditional))

    @property
    def _linkages(self) -> tuple[tuple[int, ...], ...]:
        return self._frames[-1].observations.skeleton.linkages

    def _segment(self, positions_m: Float[np.ndarray, "frame joint 3"]) -> Segment:
        """Of the frames that are solved, from these positions on."""
        frames, first = self._frames, self._frames[0]
        before = None if self._marginal is None else Predecessor(first.at.time_s - first.step_s, first.linked)
        return Segment(
            rig=self._rig,
            skeleton=first.observations.skeleton,
            config=self._config,
            evidence=concatenated([state.evidence for state in frames]),
            active=np.array([state.active for state in frames]),
            lengths_m=self._lengths.learned.lengths_m,
            process_density=np.array([state.process_density for state in frames]),
            known=self._lengths.learned,
            lengths_known=True,
            initial_m=positions_m,
            before=before,
            marginal=self._marginal,
            linked=np.array([state.linked for state in frames]),
        )

    def _pose(self, state: FrameState) -> Float[np.ndarray, "kind joint 3"]:
        """Positions and, with constant velocity, velocities; zero where a joint is not estimated."""
        kinds = [state.positions_m, state.velocities_mps]
        pose = np.array(kinds if self._config.motion.model == "constant_velocity" else kinds[:1])
        return np.where(state.active[:, None], pose, 0.0)
