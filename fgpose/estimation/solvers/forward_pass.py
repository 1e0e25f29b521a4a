"""The first frames of normal equations, eliminated one after the other: what each tells about the next one, and what
that tells about it.

These are the forward and the backward pass of Rauch, Tung and Striebel's smoother (1965, "Maximum likelihood estimates
of linear dynamic systems"), around poses that need not be the optimum.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain

import numpy as np
from jaxtyping import Float, Int

from fgpose.estimation.factors.state import BatchState
from fgpose.estimation.segment import LinkageBlocks, Marginal
from fgpose.estimation.solvers.block_tridiagonal import BlockTridiagonal
from fgpose.estimation.solvers.normal_equations import NormalEquations
from fgpose.frozen import changed


@dataclass(frozen=True, eq=False)
class Conditional:
    """A frame that has been eliminated, given the next one.

    Unknowns are those of a pose, see unknowns_of; those of joints that are not estimated do not count.
    """

    pose: Float[np.ndarray, " unknown"]
    """If the next frame is at next_pose."""
    next_pose: Float[np.ndarray, " unknown"]
    gain: LinkageBlocks
    """How the pose follows that of the next frame."""
    covariance: LinkageBlocks
    """Given the next frame."""

    @staticmethod
    def of_nobody(pose: Float[np.ndarray, "kind joint 3"], linkages: tuple[tuple[int, ...], ...]) -> Conditional:
        """Nothing is estimated."""
        sizes = [3 * len(pose) * len(joints) for joints in linkages]
        nothing = LinkageBlocks(linkages, tuple(np.zeros((size, size)) for size in sizes))
        unknowns = unknowns_of(pose, linkages)
        return Conditional(unknowns, unknowns, nothing, nothing)

    def given(self, next_pose: Float[np.ndarray, " unknown"]) -> Float[np.ndarray, " unknown"]:
        """The pose, if this is that of the next frame."""
        return self.pose + self.gain.times(next_pose - self.next_pose)

    def marginal(self, of_next: LinkageBlocks) -> LinkageBlocks:
        """The covariance, if this is that of the next frame."""
        blocks = zip(self.covariance.blocks, self.gain.blocks, of_next.blocks, strict=True)
        return changed(of_next, blocks=tuple(own + gain @ later @ gain.T for own, gain, later in blocks))


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
        self._n_eliminated, self._pull = 0, np.zeros_like(self._gradients[0])

    def eliminate(self) -> tuple[Marginal, Conditional]:
        """The first of the frames that are left, unless it is the last."""
        t, n_kinds, problem = self._n_eliminated, self._gradients.shape[1], self._problem
        moved, of_linkages = np.empty_like(self._gradients[0]), []
        for number, slots in enumerate(problem.linkages):
            covariance = self._matrix.inverse_given_next(t, number)
            pull = _by_joint(self._gradients[t][:, slots] + self._pull[:, slots])
            gain, information = self._linked(t, slots, covariance)
            of_linkages.append((information, gain, covariance))
            moved[:, slots] = _by_kind(covariance @ pull, n_kinds)
            self._pull[:, slots] = _by_kind(gain.T @ pull, n_kinds)
        moved, gradient = problem.of_joints(np.stack([moved, self._by_motion[t] + self._pull]))
        pose, next_pose = self._poses[t] - moved, self._poses[t + 1]
        information, gain, covariance = map(problem.of_all_joints, zip(*of_linkages, strict=True))
        self._n_eliminated += 1
        around = unknowns_of(next_pose, gain.linkages)
        conditional = Conditional(unknowns_of(pose, gain.linkages), around, gain, covariance)
        return Marginal(information, gradient, next_pose), conditional

    def _linked(
        self, t: int, slots: Int[np.ndarray, " slot"], covariance: Float[np.ndarray, "unknown unknown"]
    ) -> tuple[Float[np.ndarray, "unknown unknown"], Float[np.ndarray, "unknown unknown"]]:
        """How a linkage in a frame follows the next one, and what the frame tells about that."""
        motion = self._problem.motions
        strength = np.repeat(motion.strength[t, slots], 3)[:, None, None]
        coupling, precision = (strength * each[t] for each in (motion.coupling, motion.precision))
        gain = -_coupled(coupling, covariance).T
        information = _coupled(coupling, gain)
        np.einsum("ukul->ukl", information.reshape(2 * coupling.shape[:2]))[:] += precision
        return gain, (information + information.T) / 2


def _coupled(
    coupling: Float[np.ndarray, "axis kind kind"], of_earlier: Float[np.ndarray, "unknown unknown"]
) -> Float[np.ndarray, "unknown unknown"]:
    """U^T A, where the unknowns of a frame are coupled with the same ones of the next."""
    by_axis = of_earlier.reshape(*coupling.shape[:2], len(of_earlier))
    return (coupling.swapaxes(1, 2) @ by_axis).reshape(of_earlier.shape)


def unknowns_of(
    pose: Float[np.ndarray, "kind joint 3"], linkages: tuple[tuple[int, ...], ...]
) -> Float[np.ndarray, " unknown"]:
    """Of positions in m and, with constant velocity, velocities in m/s: ordered by linkage, joint, axis, kind."""
    return _by_joint(pose[:, list(chain(*linkages))])


def pose_of(
    unknowns: Float[np.ndarray, " unknown"], n_kinds: int, linkages: tuple[tuple[int, ...], ...]
) -> Float[np.ndarray, "kind joint 3"]:
    """The inverse of unknowns_of."""
    by_linkage = _by_kind(unknowns, n_kinds)
    pose = np.empty_like(by_linkage)
    pose[:, list(chain(*linkages))] = by_linkage
    return pose


def _by_joint(pose: Float[np.ndarray, "kind joint 3"]) -> Float[np.ndarray, " unknown"]:
    return pose.transpose(1, 2, 0).ravel()


def _by_kind(unknowns: Float[np.ndarray, " unknown"], n_kinds: int) -> Float[np.ndarray, "kind joint 3"]:
    return unknowns.reshape(-1, 3, n_kinds).transpose(2, 0, 1)
