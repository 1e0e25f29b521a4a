"""Motion: white noise on the acceleration or on the velocity of a joint, from the frame before to this one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import gtsam
import numpy as np
from jaxtyping import Float

from fgpose.config import MotionConfig
from fgpose.estimation.factors.state import BatchState, Information
from fgpose.estimation.keys import Keys
from fgpose.estimation.process_noise import least_density
from fgpose.estimation.segment import Segment
from fgpose_factors import State, constant_velocity_factor, random_walk_factor

# If the motion model predicts a position better than this, the information of the cameras is lost in rounding errors of
# the elimination, and GTSAM calls the system indeterminate (seen at 4 um).
_FINEST_STEP_M = 1e-5


@dataclass(frozen=True, eq=False)
class Motions:
    """x_{t+1} = F_t x_t with white noise, for each joint that is there in both frames."""

    density: Float[np.ndarray, "frame slot"]
    """Power spectral density q of the noise from the frame before; inf where a joint is not estimated in both
    frames."""
    step_s: Float[np.ndarray, " frame"]
    """Time since the frame before; inf for a first frame without predecessor."""
    with_velocity: bool
    """Constant velocity; otherwise random walk."""

    @classmethod
    def of(cls, segment: Segment) -> Iterator[Motions]:
        """Always one table, even without a motion model: the solver must know that frames are not coupled."""
        density = np.where(segment.kept, segment.process_density, np.inf)[:, segment.joints]
        step_s = np.maximum(segment.step_s, shortest_step_s(segment.config.motion))
        yield cls(density, step_s, segment.with_velocity)

    def graph_factors(self, keys: Keys) -> Iterator[gtsam.NonlinearFactor]:
        for frame, slot in np.argwhere(np.isfinite(self.density)).tolist():
            before, after = frame - 1, frame
            step_s, density = float(self.step_s[frame]), float(self.density[frame, slot])
            if self.with_velocity:
                yield constant_velocity_factor(
                    State(keys.position(before, slot), keys.velocity(before, slot), 0.0),
                    State(keys.position(after, slot), keys.velocity(after, slot), step_s),
                    density,
                )
            else:
                yield random_walk_factor(keys.position(before, slot), keys.position(after, slot), step_s, density)

    @cached_property
    def strength(self) -> Float[np.ndarray, "step slot"]:
        """1 / q between the frames of the segment; zero where a joint is not there in both."""
        return 1 / self.density[1:]

    @cached_property
    def transition(self) -> Float[np.ndarray, "step kind kind"]:
        """F_t."""
        step_s = self.step_s[1:]
        one, zero = np.ones_like(step_s), np.zeros_like(step_s)
        blocks = [[one, step_s], [zero, one]] if self.with_velocity else [[one]]
        return np.array(blocks).transpose(2, 0, 1)

    @cached_property
    def precision(self) -> Float[np.ndarray, "step kind kind"]:
        """Inverse covariance of noise of density q = 1."""
        step_s = self.step_s[1:]
        across = -6 / step_s**2
        blocks = [[12 / step_s**3, across], [across, 4 / step_s]] if self.with_velocity else [[1 / step_s]]
        return np.array(blocks).transpose(2, 0, 1)

    @cached_property
    def coupling(self) -> Float[np.ndarray, "step kind kind"]:
        """Information between an earlier and a later frame, q = 1."""
        return -np.swapaxes(self.transition, 1, 2) @ self.precision

    def error(self, state: BatchState) -> float:
        unpredicted, pull = self._at(state)
        return 0.5 * float((unpredicted * pull).sum())

    def add_gradient(self, gradient: BatchState, state: BatchState) -> None:
        unpredicted, pull = self._at(state)
        gradient.joints[1:] += pull
        gradient.joints[:-1] += self._weighted(self.coupling, unpredicted)

    def pull_on_later(self, state: BatchState) -> Float[np.ndarray, "step kind slot 3"]:
        """The gradient by the later frame of each step."""
        _, pull = self._at(state)
        return pull

    def add_information(self, information: Information, state: BatchState) -> None:
        """The blocks within frames; those between frames are the coupling."""
        strength = self.strength[:, None, None, :, None]
        earlier = -self.coupling @ self.transition
        information.single_axes[1:] += strength * self.precision[..., None, None]
        information.single_axes[:-1] += strength * earlier[..., None, None]

    def _at(self, state: BatchState) -> tuple[np.ndarray, np.ndarray]:
        """The residual, x_{t+1} - F_t x_t, and its pull on the later frame."""
        return state.evaluated(self, self._evaluated)

    def _evaluated(
        self, state: BatchState
    ) -> tuple[Float[np.ndarray, "step kind slot 3"], Float[np.ndarray, "step kind slot 3"]]:
        unpredicted = state.joints[1:] - _by_kind(self.transition, state.joints[:-1])
        return unpredicted, self._weighted(self.precision, unpredicted)

    def _weighted(self, matrices: np.ndarray, unpredicted: np.ndarray) -> Float[np.ndarray, "step kind slot 3"]:
        return self.strength[:, None, :, None] * _by_kind(matrices, unpredicted)


def _by_kind(matrices: np.ndarray, joints: np.ndarray) -> Float[np.ndarray, "step kind slot 3"]:
    return np.einsum("tkl,tlja->tkja", matrices, joints)


def shortest_step_s(config: MotionConfig) -> float:
    """The least time step of the motion model; frames that are closer in time are treated as this far apart.

    Within it the model predicts a position to _FINEST_STEP_M: q h = s^2, or q h^3 / 12 = s^2. That is at most 1.6 ms
    with the default densities.
    """
    if config.model == "random_walk":
        return _FINEST_STEP_M**2 / least_density(config)
    return (12 * _FINEST_STEP_M**2 / least_density(config)) ** (1 / 3)
