"""What the window of the online estimator asks of its solver."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float

from fgpose.estimation.frame_state import FrameState
from fgpose.geometry.camera import CameraRig

REVISED_S = 0.25
"""So many of the last seconds are revised. Joints stay hidden for about as long (visibility.hidden_s), so later images
hardly tell more: with half of it the errors on the tuning clips of the benchmark are 3 % larger with two occluded
cameras, with 0.6 and 1.2 s they differ by less than 1 %."""


@runtime_checkable
class WindowSolver(Protocol):
    """Holds the variables of frames and what is known of them. Frames are numbered from the oldest that is there.

    `changes` are states of frames by their number; what changes is the evidence of their active joints.
    """

    @property
    def revised_every_s(self) -> float:
        """How often it is worth while to change frames."""
        ...

    @property
    def repairs(self) -> int:
        """How often it failed and began anew."""
        ...

    def add(self, state: FrameState, rig: CameraRig, changes: Mapping[int, FrameState]) -> None:
        """Take the newest frame, and change others in the same update."""
        ...

    def replace(
        self, changes: Mapping[int, FrameState], rig: CameraRig, entering: Bool[np.ndarray, " joint"] | None = None
    ) -> None:
        """Change frames; these joints of the last of them are estimated from now on."""
        ...

    def move(
        self, at: int, state: FrameState, joints: list[int], to_m: Float[np.ndarray, "joint 3"], rig: CameraRig
    ) -> None:
        """Linearise joints of a frame anew at these positions."""
        ...

    def drop_oldest(self) -> None:
        """Marginalise the oldest frame."""
        ...

    def read(self, state: FrameState) -> FrameState:
        """The state with the estimated values in place of the guesses."""
        ...

    def covariances_m2(self, newest: FrameState) -> Float[np.ndarray, "active_joint 3 3"]:
        """Marginal covariance of each position of the newest frame."""
        ...

    def lagged_covariances_m2(self, oldest: FrameState) -> Float[np.ndarray, "active_joint 3 3"]:
        """The same of the oldest frame; NaN where the solver does not give it."""
        ...
