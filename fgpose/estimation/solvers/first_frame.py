"""The first frame of a segment, eliminated: what it tells about the second one, and what that tells about it.

These are the forward and the backward pass of Rauch, Tung and Striebel's smoother (1965, "Maximum likelihood estimates
of linear dynamic systems"), around a pose that need not be the optimum.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from fgpose.estimation.segment import Marginal, Segment
from fgpose.estimation.solvers.normal_equations import NormalEquations


@dataclass(frozen=True, eq=False)
class Conditional:
    """A frame that has been eliminated, given the next one.

    A pose has positions in m and, with constant velocity, velocities in m/s. Unknowns are ordered by joint, axis, kind;
    those of joints that are not estimated do not count.
    """

    pose: Float[np.ndarray, "kind joint 3"]
    """If the next frame is at next_pose."""
    next_pose: Float[np.ndarray, "kind joint 3"]
    gain: Float[np.ndarray, "unknown unknown"]
    """How the pose follows that of the next frame."""
    covariance: Float[np.ndarray, "unknown unknown"]
    """Given the next frame."""

    def given(self, next_pose: Float[np.ndarray, "kind joint 3"]) -> Float[np.ndarray, "kind joint 3"]:
        """The pose, if this is that of the next frame."""
        follows = self.gain @ _unknowns(next_pose - self.next_pose)
        return self.pose + _of_kinds(follows, len(self.pose))

    def marginal(self, of_next: Float[np.ndarray, "unknown unknown"]) -> Float[np.ndarray, "unknown unknown"]:
        """The covariance, if this is that of the next frame."""
        return self.covariance + self.gain @ of_next @ self.gain.T


def eliminate_first(segment: Segment, poses: Float[np.ndarray, "2 kind joint 3"]) -> tuple[Marginal, Conditional]:
    """The first of two frames with all its factors, linearised at these poses; the second one keeps its own factors.

    Raises:
        numpy.linalg.LinAlgError: no prior makes the first frame determinate.
    """
    problem, n_kinds = NormalEquations(segment), poses.shape[1]
    state = problem.at(poses)
    motion, strength = problem.motions, np.repeat(problem.motions.strength[0], 3)[:, None, None]
    coupling, precision = (_block_diagonal(strength * each[0]) for each in (motion.coupling, motion.precision))
    covariance = problem.first_covariance(state)
    pull, pull_of_motion = _unknowns(problem.joint_gradient(state)[0]), _unknowns(motion.pull(state)[1])
    gain = -covariance @ coupling
    information = precision + coupling.T @ gain
    moved, of_motion = (_of_kinds(each, n_kinds) for each in (covariance @ pull, pull_of_motion + gain.T @ pull))
    found = np.stack([state.joints[0] - moved, of_motion])
    (pose, gradient), around = problem.poses(replace(state, joints=found)), problem.poses(state)[1]
    information = problem.of_all_joints((information + information.T) / 2)
    by_joint = segment.skeleton.n_joints, 3, n_kinds
    marginal = Marginal(information.reshape(*by_joint, *by_joint), gradient, around)
    return marginal, Conditional(pose, around, problem.of_all_joints(gain), problem.of_all_joints(covariance))


def _block_diagonal(blocks: Float[np.ndarray, "axis kind kind"]) -> Float[np.ndarray, "unknown unknown"]:
    n_axes, n_kinds, _ = blocks.shape
    matrix = np.zeros((n_axes, n_kinds, n_axes, n_kinds))
    np.einsum("ukul->ukl", matrix)[:] = blocks
    return matrix.reshape(n_axes * n_kinds, n_axes * n_kinds)


def _unknowns(pose: Float[np.ndarray, "kind joint 3"]) -> Float[np.ndarray, " unknown"]:
    return np.moveaxis(pose, 0, -1).ravel()


def _of_kinds(unknowns: Float[np.ndarray, " unknown"], n_kinds: int) -> Float[np.ndarray, "kind joint 3"]:
    return np.moveaxis(unknowns.reshape(-1, 3, n_kinds), -1, 0)
