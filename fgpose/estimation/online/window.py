"""The frames that the online estimator holds."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping

import numpy as np
from jaxtyping import Bool, Float

from fgpose.config import Config
from fgpose.estimation.frame_state import FrameState
from fgpose.estimation.online.bone_lengths import RunningLengths
from fgpose.estimation.online.window_equations import WindowEquations
from fgpose.estimation.online.window_graph import WindowGraph
from fgpose.estimation.online.window_solver import WindowSolver
from fgpose.geometry.camera import CameraRig
from fgpose.sampling import TIME_ROUNDING_S, usual_step_s

_SOLVERS: dict[str, Callable[[RunningLengths, Config], WindowSolver]] = {
    "isam2": WindowGraph,
    "window": WindowEquations,
}


class Window:
    """The frames of the last online.lag_s in the order of time, and one that is older: all that is known of each, and
    what estimates them.

    Frames are numbered from the oldest; -1 is the newest.

    Args:
        lengths: of the bones, as they are learned.
        config: all parameters.
    """

    def __init__(self, lengths: RunningLengths, config: Config) -> None:
        self._frames: deque[FrameState] = deque()
        self._left: FrameState | None = None
        self._solver: WindowSolver = _SOLVERS[config.online.solver](lengths, config)
        self._lag_s = config.online.lag_s
        self._read: set[int] = set()
        """Numbers of the frames that have been read since the solver took anything."""

    def __len__(self) -> int:
        return len(self._frames)

    def __iter__(self) -> Iterator[FrameState]:
        return iter(self._frames)

    def __getitem__(self, at: int) -> FrameState:
        return self._frames[at]

    def __setitem__(self, at: int, state: FrameState) -> None:
        self._frames[at] = state

    def before(self, at: int) -> FrameState | None:
        """The frame before one, also where that has left the window."""
        return self._frames[at - 1] if at > 0 else self._left

    @property
    def times_s(self) -> Float[np.ndarray, " frame"]:
        return np.array([state.at.time_s for state in self._frames])

    @property
    def usual_step_s(self) -> float:
        """Usual time from frame to frame."""
        return usual_step_s(self.times_s)

    @property
    def repairs(self) -> int:
        """See FixedLagSmoother."""
        return self._solver.repairs

    @property
    def revised_every_s(self) -> float:
        """How often it is worth while to change frames."""
        return self._solver.revised_every_s

    @property
    def lagged(self) -> FrameState | None:
        """The newest frame that is at least one lag old, with its present estimate."""
        return self.read(0) if self._is_lagged(self._frames[0]) else None

    def read(self, at: int) -> FrameState:
        """A frame with its present estimate."""
        if (number := self._frames[at].at.frame) not in self._read:
            self._frames[at] = self._solver.read(self._frames[at])
            self._read.add(number)
        return self._frames[at]

    def add(self, state: FrameState, rig: CameraRig, changes: Mapping[int, FrameState]) -> None:
        """Take the newest frame, and change others in the same update; see WindowGraph."""
        self._solver.add(state, rig, changes)
        self._frames.append(state)
        self._read_anew(-1)

    def change(self, changes: Mapping[int, FrameState], rig: CameraRig) -> None:
        """Change frames; see WindowGraph."""
        self._solver.replace(changes, rig)
        self._read_anew(-1)

    def join(self, at: int, state: FrameState, rig: CameraRig, entering: Bool[np.ndarray, " joint"]) -> None:
        """Change a frame that another image joins, by which these joints enter."""
        self._solver.replace({at: state}, rig, entering)
        self._frames[at] = state
        self._read_anew(at)

    def move(self, at: int, joints: list[int], to_m: Float[np.ndarray, "joint 3"], rig: CameraRig) -> None:
        """Linearise joints of a frame anew at these positions."""
        self._solver.move(at, self._frames[at], joints, to_m, rig)
        self._read_anew(at)

    def marginalise(self) -> Iterator[FrameState]:
        """Let the frames leave that are older than the lag, except the newest of them: that one is the smoothed result.

        Yields:
            The oldest frame each time that one has left.
        """
        while len(self._frames) > 1 and self._is_lagged(self._frames[1]):
            self._left = self._frames.popleft()
            self._solver.drop_oldest()
            yield self.read(0)

    def newest_covariances_m2(self) -> Float[np.ndarray, "active_joint 3 3"]:
        """Marginal covariance of each position of the newest frame."""
        return self._solver.covariances_m2(self._frames[-1])

    def oldest_covariances_m2(self) -> Float[np.ndarray, "active_joint 3 3"]:
        """The same of the oldest frame; NaN where the window does not give it."""
        return self._solver.lagged_covariances_m2(self._frames[0])

    def _read_anew(self, at: int) -> None:
        """Read a frame after the solver has taken something: what was read before is not the present estimate."""
        self._read.clear()
        self.read(at)

    def _is_lagged(self, state: FrameState) -> bool:
        return state.at.time_s <= self._frames[-1].at.time_s - self._lag_s + TIME_ROUNDING_S
