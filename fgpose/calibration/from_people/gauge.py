"""What the images do not tell, a similarity: covariances about the centroid of the rig, and rigs laid on each other."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.calibration.from_people.projection import ROTATION, TRANSLATION
from fgpose.geometry.camera import CameraRig


def in_world_frame(
    covariance: Float[np.ndarray, "camera k camera k"], rig: CameraRig
) -> Float[np.ndarray, "camera k camera k"]:
    """Rotations (radians) and translations along the axes of the world instead of those of each camera."""
    n_cameras, each = covariance.shape[:2]
    turn = np.zeros((n_cameras, each, each))
    turn[:] = np.eye(each)
    for c, camera in enumerate(rig.cameras):
        turn[c, ROTATION, ROTATION] = turn[c, TRANSLATION, TRANSLATION] = camera.world_T_camera[:3, :3]
    return np.einsum("cik,ckdl,djl->cidj", turn, covariance, turn)


def about_centroid(
    covariance: Float[np.ndarray, "camera k camera k"], rig: CameraRig, *, scale_is_known: bool = False
) -> Float[np.ndarray, "camera k camera k"]:
    """The covariance of the cameras after a similarity that lays them on the true ones as well as they can be.

    With the first camera held it looks perfect, and the farthest one worst. The projection that takes the similarity
    out is Baarda's S-transformation (1973); positions count in units of the size of the rig, rotations in radians.

    Args:
        covariance: world frame (in_world_frame).
        rig: the cameras.
        scale_is_known: whether only rotation and translation are taken out.
    """
    moves = _similarities(rig, covariance.shape[1])
    moves = moves[..., :6] if scale_is_known else moves
    weights = np.zeros(covariance.shape[:2])
    weights[:, ROTATION], weights[:, TRANSLATION] = 1.0, 1 / _size_m(rig) ** 2
    flat, weights = moves.reshape(-1, moves.shape[-1]), weights.ravel()
    normal = flat.T @ (weights[:, None] * flat)
    keep = np.eye(len(flat)) - flat @ np.linalg.solve(normal, flat.T * weights)
    return (keep @ covariance.reshape(len(flat), -1) @ keep.T).reshape(covariance.shape)


def _similarities(rig: CameraRig, each: int) -> Float[np.ndarray, "camera k 7"]:
    """How a rotation about the centroid, a translation and a scale move the unknowns of the cameras."""
    positions_m = np.stack([camera.position_m for camera in rig.cameras])
    from_centroid_m = positions_m - positions_m.mean(axis=0)
    moves = np.zeros((rig.n_cameras, each, 7))
    moves[:, ROTATION, 0:3] = np.eye(3)
    moves[:, TRANSLATION, 0:3] = np.cross(np.eye(3), from_centroid_m[:, None]).swapaxes(1, 2)
    moves[:, TRANSLATION, 3:6] = np.eye(3)
    moves[:, TRANSLATION, 6] = from_centroid_m
    return moves


def _size_m(rig: CameraRig) -> float:
    positions_m = np.stack([camera.position_m for camera in rig.cameras])
    spread_m = positions_m - positions_m.mean(axis=0)
    return float(np.sqrt(np.mean(np.sum(spread_m**2, axis=1))))
