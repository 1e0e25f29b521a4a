"""Normal equations of cameras, lengths and biases with the joints of every frame eliminated (Schur complement).

The joints of a frame hang together by their bones, those of different frames do not. A bias is that of one joint, in
one camera or in all, and is seen in the frames of its sector.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Gauss-Newton's, by blocks; shared are the unknowns of cameras and lengths."""

    shared: Float[np.ndarray, "shared shared"]
    biases: Float[np.ndarray, "sector camera joint 2 2"]
    """As if those of all cameras were unknowns of their own."""
    joints: Float[np.ndarray, "frame coordinate coordinate"]
    shared_biases: Float[np.ndarray, "shared sector camera joint 2"]
    shared_joints: Float[np.ndarray, "frame shared coordinate"]
    biases_joints: Float[np.ndarray, "frame joint camera 2 3"]
    """A bias and the joint it is of."""
    sector: Int[np.ndarray, "frame camera"]
    in_common: bool
    """Whether the biases of all cameras are the same unknowns."""
    bias_prior: float
    """Information on each unknown, 1/m^2."""

    @property
    def n_shared(self) -> int:
        return len(self.shared)

    def bias_index(self, *, in_common: bool) -> Int[np.ndarray, "frame joint camera 2"]:
        """Where the biases that a frame sees are among all."""
        _, n_cameras, n_joints = self.biases.shape[:3]
        by_view = self.sector if in_common else self.sector * n_cameras + np.arange(n_cameras)
        by_joint = by_view[:, None, :] * n_joints + np.arange(n_joints)[:, None]
        return 2 * by_joint[..., None] + np.arange(2)

    def contracted(self, system: Float[np.ndarray, "outer outer"]) -> Float[np.ndarray, "unknown unknown"]:
        """Shared unknowns and biases as they are, from a matrix that has the biases of each camera."""
        if not self.in_common:
            return system
        n_sectors, n_cameras = self.biases.shape[:2]
        for axis in (0, 1):
            shared, biases = np.split(system, [self.n_shared], axis=axis)
            shape = *biases.shape[:axis], n_sectors, n_cameras, -1, *biases.shape[axis + 1 :]
            summed = biases.reshape(shape).sum(axis=axis + 1)
            merged = *biases.shape[:axis], -1, *biases.shape[axis + 1 :]
            system = np.concatenate([shared, summed.reshape(merged)], axis=axis)
        return system


class Eliminated:
    """The equations of shared unknowns and biases, factorised.

    Raises:
        LinAlgError: they are not positive definite.
    """

    def __init__(self, equations: NormalEquations) -> None:
        from scipy.linalg import LinAlgError, cho_factor

        self._equations = equations
        self._of_joints = np.linalg.inv(equations.joints)
        self._by_shared = equations.shared_joints @ self._of_joints
        self._bias_index = equations.bias_index(in_common=equations.in_common)
        system = equations.contracted(self._system())
        every = np.arange(equations.n_shared, len(system))
        system[every, every] += equations.bias_prior
        self._factor = cho_factor(system, lower=True, overwrite_a=True, check_finite=False)
        if not np.isfinite(self._factor[0]).all():
            raise LinAlgError("the normal equations are not finite")

    def solve(self, right_hand_side: Float[np.ndarray, " unknown"]) -> Float[np.ndarray, " unknown"]:
        """Of everything: shared unknowns, biases, joints, one after the other."""
        from scipy.linalg import cho_solve

        equations, n_shared = self._equations, self._equations.n_shared
        n_outer = len(self._factor[0])
        outer, of_joints = right_hand_side[:n_outer].copy(), right_hand_side[n_outer:]
        of_joints = of_joints.reshape(len(equations.joints), -1)
        alone = np.einsum("txy,ty->tx", self._of_joints, of_joints)
        outer[:n_shared] -= np.einsum("tux,tx->u", equations.shared_joints, alone)
        pulled = np.einsum("tjcia,tja->tjci", equations.biases_joints, alone.reshape(*self._bias_index.shape[:2], 3))
        np.subtract.at(outer, n_shared + self._bias_index, pulled)
        outer = cho_solve(self._factor, outer, check_finite=False)
        by_bias = np.einsum("tjcia,tjci->tja", equations.biases_joints, outer[n_shared + self._bias_index])
        through = np.einsum("tux,u->tx", equations.shared_joints, outer[:n_shared]) + by_bias.reshape(alone.shape)
        return np.append(outer, alone - np.einsum("txy,ty->tx", self._of_joints, through))

    def shared_covariance(self) -> Float[np.ndarray, "shared shared"]:
        """Marginal: biases and joints are unknown too."""
        from scipy.linalg import cho_solve

        n_shared = self._equations.n_shared
        unit = np.eye(len(self._factor[0]), n_shared)
        return cho_solve(self._factor, unit, check_finite=False)[:n_shared]

    def _system(self) -> Float[np.ndarray, "outer outer"]:
        """With the biases of each camera as unknowns of their own."""
        equations, n_shared = self._equations, self._equations.n_shared
        n_biases = equations.biases.size // 2
        system = np.zeros((n_shared + n_biases,) * 2)
        flat = self._by_shared.transpose(1, 0, 2).reshape(n_shared, -1)
        across = equations.shared_joints.transpose(1, 0, 2).reshape(n_shared, -1)
        system[:n_shared, :n_shared] = equations.shared - flat @ across.T
        system[n_shared:, :n_shared] = equations.shared_biases.reshape(n_shared, -1).T
        pairs = n_shared + np.arange(n_biases).reshape(-1, 2)
        system[pairs[:, :, None], pairs[:, None, :]] = equations.biases.reshape(-1, 2, 2)
        own_index = equations.bias_index(in_common=False)
        for frame, index in enumerate(n_shared + own_index.reshape(len(own_index), -1)):
            by_shared, by_bias = self._through_joints(frame)
            system[index, :n_shared] -= by_shared.T
            system[np.ix_(index, index)] -= by_bias
        return system

    def _through_joints(self, frame: int) -> tuple[Float[np.ndarray, "shared bias"], Float[np.ndarray, "bias bias"]]:
        """What the joints of a frame take from the equations of the biases that it sees."""
        n_joints = self._bias_index.shape[1]
        biases = self._equations.biases_joints[frame].reshape(n_joints, -1, 3)
        by_bias = biases @ self._of_joints[frame].reshape(n_joints, 3, -1)
        return _onto(self._by_shared[frame], biases), _onto(by_bias.reshape(-1, 3 * n_joints), biases)


def _onto(
    rows: Float[np.ndarray, "row coordinate"], biases: Float[np.ndarray, "joint view 3"]
) -> Float[np.ndarray, "row bias"]:
    """Products of rows over all coordinates of a frame with the biases, each of which is that of one joint."""
    by_joint = rows.reshape(len(rows), len(biases), 3).swapaxes(0, 1)
    return (by_joint @ biases.swapaxes(1, 2)).swapaxes(0, 1).reshape(len(rows), -1)
