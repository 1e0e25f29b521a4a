"""Least squares in cameras and joints with the joints eliminated (Schur complement), as in bundle adjustment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

# What keeps a joint that no two cameras see invertible; it then contributes nothing. The relative one is far above the
# rounding errors of a joint next to a camera, whose information is 1e8 / m^2 in two directions and zero in the third.
_MIN_INFORMATION = 1e-9  # 1/m^2
_MIN_INFORMATION_SHARE = 1e-12


@dataclass(frozen=True, eq=False)
class ReducedSystem:
    """Gauss-Newton's normal equations of the cameras' unknowns, camera after camera; the joints follow them."""

    information: Float[np.ndarray, "unknown unknown"]
    gradient: Float[np.ndarray, " unknown"]
    joint_covariance_m2: Float[np.ndarray, "frame joint 3 3"]
    """Of each joint, the cameras held."""
    by_step: Float[np.ndarray, "frame joint unknown 3"]
    """How each joint's solution depends on the step of the cameras."""

    def eliminated(
        self, of_cameras: Float[np.ndarray, " unknown"], of_joints: Float[np.ndarray, "frame joint 3"]
    ) -> Float[np.ndarray, " unknown"]:
        """A right-hand side of the whole system without the joints."""
        return of_cameras - np.einsum("tjua,tja->u", self.by_step, of_joints)

    def joint_steps_m(
        self, step: Float[np.ndarray, " unknown"], of_joints: Float[np.ndarray, "frame joint 3"]
    ) -> Float[np.ndarray, "frame joint 3"]:
        """The solution for the joints that goes with that of the cameras (back-substitution).

        Args:
            step: solution for the cameras.
            of_joints: the joints' part of the right-hand side.
        """
        own_m = (self.joint_covariance_m2 @ of_joints[..., None])[..., 0]
        return own_m - np.einsum("tjua,u->tja", self.by_step, step)


def eliminate_joints(
    residual_px: Float[np.ndarray, "frame camera joint 2"],
    by_joint: Float[np.ndarray, "frame camera joint 2 3"],
    by_camera: Float[np.ndarray, "frame camera joint 2 each"],
    weights: Float[np.ndarray, "frame camera joint"],
    damping: float = 0.0,
) -> ReducedSystem:
    """Normal equations of residuals that depend on one joint and on the unknowns of one camera each.

    Args:
        residual_px: finite, also where there is no detection.
        by_joint: Jacobian by the joint's position, 1/m; finite.
        by_camera: Jacobian by the unknowns of the camera that has the residual; finite.
        weights: information of each detection, 1/px^2; 0 where there is none.
        damping: added to the information of each coordinate of the joints, 1/m^2.
    """
    n_cameras, each = by_camera.shape[1], by_camera.shape[-1]
    weighted = weights[..., None, None] * by_joint
    of_joints = np.einsum("tcjia,tcjib->tjab", weighted, by_joint)
    least = _MIN_INFORMATION + damping + _MIN_INFORMATION_SHARE * np.trace(of_joints, axis1=-2, axis2=-1)
    of_joints += least[..., None, None] * np.eye(3)
    across = np.einsum("tcjik,tcjia->tjcka", by_camera, weighted)
    across = across.reshape(*across.shape[:2], n_cameras * each, 3)
    inverse = np.linalg.inv(of_joints)
    by_step = across @ inverse
    pull = np.einsum("tcji,tcjia->tja", residual_px, weighted)
    of_cameras = np.zeros((n_cameras, each, n_cameras, each))
    cameras, weighted = np.arange(n_cameras), weights[..., None, None] * by_camera
    of_cameras[cameras, :, cameras] = np.einsum("tcjik,tcjil->ckl", weighted, by_camera)
    eliminated = np.tensordot(by_step, across, axes=((0, 1, 3), (0, 1, 3)))
    gradient = np.einsum("tcji,tcjik->ck", residual_px, weighted).ravel() - np.einsum("tjua,tja->u", by_step, pull)
    return ReducedSystem(of_cameras.reshape(eliminated.shape) - eliminated, gradient, inverse, by_step)
