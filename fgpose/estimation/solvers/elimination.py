"""Least squares in cameras and joints with the joints eliminated (Schur complement), as in bundle adjustment."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from fgpose.estimation.noise import ROUNDING

# What keeps a joint that no two cameras see invertible; it then contributes nothing.
_MIN_INFORMATION = 1e-9  # 1/m^2


@dataclass(frozen=True, eq=False)
class ReducedSystem:
    """Gauss-Newton's normal equations of what is the same in all frames: the unknowns of camera after camera, then the
    biases of joint after joint. The positions of the joints follow them."""

    information: Float[np.ndarray, "unknown unknown"]
    gradient: Float[np.ndarray, " unknown"]
    joint_covariance_m2: Float[np.ndarray, "frame joint 3 3"]
    """Of each position, the rest held."""
    by_step: Float[np.ndarray, "frame joint own 3"]
    """How each position depends on the step of the cameras, and of the biases of its joint."""
    n_of_cameras: int
    """Unknowns of all cameras."""

    def eliminated(self, of_positions: Float[np.ndarray, "frame joint 3"]) -> Float[np.ndarray, " unknown"]:
        """What a right-hand side of the positions takes from that of the rest."""
        return _in_a_row(np.einsum("tjua,tja->ju", self.by_step, of_positions), self.n_of_cameras)

    def joint_steps_m(
        self, step: Float[np.ndarray, " unknown"], of_positions: Float[np.ndarray, "frame joint 3"]
    ) -> Float[np.ndarray, "frame joint 3"]:
        """The solution for the positions that goes with that of the rest (back-substitution).

        Args:
            step: solution for the rest.
            of_positions: the positions' part of the right-hand side.
        """
        of_cameras, of_biases = np.split(step, [self.n_of_cameras])
        _, n_joints, n_own, _ = self.by_step.shape
        of_biases = of_biases.reshape(n_joints, n_own - self.n_of_cameras)
        of_each = np.hstack([np.tile(of_cameras, (n_joints, 1)), of_biases])
        alone_m = (self.joint_covariance_m2 @ of_positions[..., None])[..., 0]
        return alone_m - np.einsum("tjua,ju->tja", self.by_step, of_each)


def eliminate_joints(
    residual_px: Float[np.ndarray, "frame camera joint 2"],
    by_joint: Float[np.ndarray, "frame camera joint 2 3"],
    by_camera: Float[np.ndarray, "frame camera joint 2 each"],
    weights: Float[np.ndarray, "frame camera joint"],
    damping: float = 0.0,
    by_bias: Float[np.ndarray, "frame camera joint 2 bias"] | None = None,
) -> ReducedSystem:
    """Normal equations of residuals that depend on the position of one joint and on the unknowns of one camera each.

    Args:
        residual_px: finite, also where there is no detection.
        by_joint: Jacobian by the joint's position, 1/m; finite.
        by_camera: Jacobian by the unknowns of the camera that has the residual; finite.
        weights: information of each detection, 1/px^2; 0 where there is none.
        damping: added to the information of each coordinate of the joints, 1/m^2.
        by_bias: Jacobian by what a joint has in all frames and cameras, its biases; finite. None: there are none.
    """
    by_bias = np.zeros((*residual_px.shape, 0)) if by_bias is None else by_bias
    (n_frames, n_cameras, n_joints), each = weights.shape, by_camera.shape[-1]
    n_of_cameras = n_cameras * each
    pull, weighted = weights[..., None] * residual_px, weights[..., None, None] * by_joint
    of_positions = np.einsum("tcjia,tcjib->tjab", weighted, by_joint)
    least = _MIN_INFORMATION + damping + ROUNDING * np.trace(of_positions, axis1=-2, axis2=-1)
    covariance_m2 = np.linalg.inv(of_positions + least[..., None, None] * np.eye(3))
    of_cameras = np.einsum("tcjik,tcjia->tjcka", by_camera, weighted).reshape(n_frames, n_joints, n_of_cameras, 3)
    across = np.concatenate([of_cameras, np.einsum("tcjib,tcjia->tjba", by_bias, weighted)], axis=2)
    by_step = across @ covariance_m2
    information = _information(by_camera, by_bias, weights) - _taken(by_step, across, n_of_cameras)
    gradient = np.einsum("tcji,tcjik->ck", pull, by_camera).ravel()
    gradient = np.append(gradient, np.einsum("tcji,tcjib->jb", pull, by_bias))
    system = ReducedSystem(information, gradient, covariance_m2, by_step, n_of_cameras)
    return replace(system, gradient=gradient - system.eliminated(np.einsum("tcji,tcjia->tja", pull, by_joint)))


def _information(
    by_camera: Float[np.ndarray, "frame camera joint 2 each"],
    by_bias: Float[np.ndarray, "frame camera joint 2 bias"],
    weights: Float[np.ndarray, "frame camera joint"],
) -> Float[np.ndarray, "unknown unknown"]:
    """Of cameras and biases, the positions held."""
    weighted, n_cameras, each = weights[..., None, None] * by_camera, by_camera.shape[1], by_camera.shape[-1]
    own, cameras = np.zeros((n_cameras, each, n_cameras, each)), np.arange(n_cameras)
    own[cameras, :, cameras] = np.einsum("tcjik,tcjil->ckl", weighted, by_camera)
    crossing = np.einsum("tcjib,tcjik->jbck", by_bias, weighted)
    among = np.einsum("tcjib,tcjid->jbd", weights[..., None, None] * by_bias, by_bias)
    n = n_cameras * each
    return _assembled(own.reshape(n, n), crossing.reshape(*crossing.shape[:2], n), among)


def _taken(
    by_step: Float[np.ndarray, "frame joint own 3"], across: Float[np.ndarray, "frame joint own 3"], n_of_cameras: int
) -> Float[np.ndarray, "unknown unknown"]:
    """What the unknown positions take from that information."""
    steps, pulls = (_side_by_side(table) for table in (by_step, across))
    of_biases = steps[:, n_of_cameras:] @ pulls.swapaxes(1, 2)
    own = np.tensordot(steps[:, :n_of_cameras], pulls[:, :n_of_cameras], axes=((0, 2), (0, 2)))
    return _assembled(own, of_biases[:, :, :n_of_cameras], of_biases[:, :, n_of_cameras:])


def _side_by_side(table: Float[np.ndarray, "frame joint own 3"]) -> Float[np.ndarray, "joint own column"]:
    """The columns of all frames."""
    n_frames, n_joints, n_own, _ = table.shape
    return np.moveaxis(table, 0, 2).reshape(n_joints, n_own, 3 * n_frames)


def _assembled(
    of_cameras: Float[np.ndarray, "rows rows"],
    crossing: Float[np.ndarray, "joint bias rows"],
    of_biases: Float[np.ndarray, "joint bias bias"],
) -> Float[np.ndarray, "unknown unknown"]:
    """The matrix of all cameras and of the biases of all joints, which are linked through the cameras alone."""
    n_joints, n_biases, n_rows = crossing.shape
    if not n_biases:
        return of_cameras
    diagonal, joints = np.zeros((n_joints, n_biases, n_joints, n_biases)), np.arange(n_joints)
    diagonal[joints, :, joints] = of_biases
    n = n_joints * n_biases
    flat = crossing.reshape(n, n_rows)
    return np.block([[of_cameras, flat.T], [flat, diagonal.reshape(n, n)]])


def _in_a_row(of_each: Float[np.ndarray, "joint own"], n_of_cameras: int) -> Float[np.ndarray, " unknown"]:
    """Cameras, to which all joints add, then the biases of joint after joint."""
    return np.append(of_each[:, :n_of_cameras].sum(axis=0), of_each[:, n_of_cameras:])
