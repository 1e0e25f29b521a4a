"""The first frames of normal equations, eliminated one after the other: what each tells about the next one, and what
that tells about it.

These are the forward and the backward pass of Rauch, Tung and Striebel's smoother (1965, "Maximum likelihood estimates
of linear dynamic systems"), around poses that need not be the optimum.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.estimation.factors.state import BatchState
from fgpose.estimation.segment import Marginal
from fgpose.estimation.solvers.block_tridiagonal import BlockTridiagonal
from fgpose.estimation.solvers.normal_equations import NormalEquations


@dataclass(frozen=True, eq=False)
class Conditional:
    """A frame that has been eliminated, given the next one.

    Unknowns are those of a pose, see unknowns_of; those of joints that are not estimated do not count.
    """

    pose: Float[np.ndarray, " unknown"]
    """If the next frame is at next_pose."""
    next_pose: Float[np.ndarray, " unknown"]
    gain: Float[np.ndarray, "unknown unknown"]
    """How the pose follows that of the next frame."""
    covariance: Float[np.ndarray, "unknown unknown"]
    """Given the next frame."""

    @staticmethod
    def of_nobody(pose: Float[np.ndarray, " unknown"]) -> Conditional:
        """Nothing is estimated."""
        nothing = np.zeros((pose.size, pose.size))
        return Conditional(pose, pose, nothing, nothing)

    def given(self, next_pose: Float[np.ndarray, " unknown"]) -> Float[np.ndarray, " unknown"]:
        """The pose, if this is that of the next frame."""
        return self.pose + self.gain @ (next_pose - self.next_pose)

    def marginal(self, of_next: Float[np.ndarray, "unknown unknown"]) -> Float[np.ndarray, "unknown unknown"]:
        """The covariance, if this is that of the next frame."""
        return self.covariance + self.gain @ of_next @ self.gain.T


class ForwardPass:
    """Each frame that is eliminated takes all factors of its own with it, and the motion to the next one.

    Args:
        problem: of the frames.
        state: around which.
        matrix: of this problem near the state, not damped.
    """

    def __init__(self, problem: NormalEquations, state: BatchState, matrix: BlockTridiagonal) -> None:
        self._problem, self._matrix = problem, matrix
        self._poses, self._gradients = problem.poses(state), problem.joint_gradient(state)
        self._by_motion = problem.motions.pull_on_later(state)
        self._n_eliminated, self._pull = 0, np.zeros(self._gradients[0].size)

    def eliminate(self) -> tuple[Marginal, Conditional]:
        """The first of the frames that are left, unless it is the last."""
        t, n_kinds = self._n_eliminated, self._gradients.shape[1]
        motion, of_all = self._problem.motions, self._problem.of_all_joints
        strength = np.repeat(motion.strength[t], 3)[:, None, None]
        coupling, precision = (strength * each[t] for each in (motion.coupling, motion.precision))
        covariance = self._matrix.inverse_given_next(t)
        gain, pull = -_coupled(coupling, covariance).T, unknowns_of(self._gradients[t]) + self._pull
        information, self._pull = _coupled(coupling, gain), gain.T @ pull
        np.einsum("ukul->ukl", information.reshape(2 * coupling.shape[:2]))[:] += precision
        on_next = self._by_motion[t] + pose_of(self._pull, n_kinds)
        moved, gradient = self._problem.of_joints(np.stack([pose_of(covariance @ pull, n_kinds), on_next]))
        pose, next_pose = self._poses[t] - moved, self._poses[t + 1]
        shape = 2 * (pose.shape[1], 3, n_kinds)
        marginal = Marginal(of_all((information + information.T) / 2).reshape(shape), gradient, next_pose)
        self._n_eliminated += 1
        return marginal, Conditional(unknowns_of(pose), unknowns_of(next_pose), of_all(gain), of_all(covariance))


def _coupled(
    coupling: Float[np.ndarray, "axis kind kind"], of_earlier: Float[np.ndarray, "unknown unknown"]
) -> Float[np.ndarray, "unknown unknown"]:
    """U^T A, where the unknowns of a frame are coupled with the same ones of the next."""
    by_axis = of_earlier.reshape(*coupling.shape[:2], len(of_earlier))
    return (coupling.swapaxes(1, 2) @ by_axis).reshape(of_earlier.shape)


def unknowns_of(pose: Float[np.ndarray, "kind joint 3"]) -> Float[np.ndarray, " unknown"]:
    """Of positions in m and, with constant velocity, velocities in m/s: ordered by joint, axis, kind."""
    return pose.transpose(1, 2, 0).ravel()


def pose_of(unknowns: Float[np.ndarray, " unknown"], n_kinds: int) -> Float[np.ndarray, "kind joint 3"]:
    """The inverse of unknowns_of."""
    return unknowns.reshape(-1, 3, n_kinds).transpose(2, 0, 1)
