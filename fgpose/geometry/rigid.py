"""Rigid motions as 4 x 4 matrices: a_T_b takes points of frame b to frame a."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

# A rotation read from a text file with six digits is orthonormal to about 1e-6; 1e-3 still catches every real mistake.
_ROTATION_TOLERANCE = 1e-3


def pose_of(R: Float[np.ndarray, "3 3"], t: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "4 4"]:
    """The motion x -> R x + t."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = R, t
    return pose


def inverse(a_T_b: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """b_T_a."""
    R = a_T_b[:3, :3]
    return pose_of(R.T, -R.T @ a_T_b[:3, 3])


def nearest_rotation(
    matrix: Float[np.ndarray, "*shape 3 3"],
) -> tuple[Float[np.ndarray, "*shape 3 3"], Float[np.ndarray, "*shape 3"]]:
    """The rotation R (no reflection) for which the trace of R^T M is largest, and the singular values of M whose sum it
    is, the last one negative where M mirrors (Kabsch 1976; Umeyama 1991).

    With M = target^T source, of points around their means, R brings the source closest to the target.
    """
    U, values, Vt = np.linalg.svd(matrix)
    sign = np.ones_like(values)
    sign[..., 2] = np.sign(np.linalg.det(U) * np.linalg.det(Vt))
    return (U * sign[..., None, :]) @ Vt, values * sign


def check_pose(a_T_b: Float[np.ndarray, "4 4"]) -> None:
    """Raise ValueError unless it is a rotation and a translation."""
    R = a_T_b[:3, :3]
    mirrors = np.linalg.det(R) < 0
    if not np.allclose(R @ R.T, np.eye(3), atol=_ROTATION_TOLERANCE) or mirrors:
        why = ", it mirrors: the world is left-handed, or an axis has the wrong sign" if mirrors else ""
        raise ValueError(f"the rotation is not a rotation matrix{why}:\n{R}")
    if not np.allclose(a_T_b[3], (0, 0, 0, 1)):
        raise ValueError("the last row of the pose must be 0 0 0 1")
