"""One rig laid on another, and what remains of errors and covariances then: no image tells the similarity.

Errors of a rig are 6 numbers a camera, in its own frame: rotation vector (radians), then translation. The similarity
that makes them smallest is taken out of them and of their covariance (Baarda's S-transformation), so that they are
about the centroid of the rig. With one camera held instead, that camera would look perfect. Translations count in units
of the size of the rig.
"""

from __future__ import annotations

import gtsam
import numpy as np
from jaxtyping import Float

from fgpose.assessment.rig_alignment import Similarity
from fgpose.geometry.camera import CameraRig

_ROUNDS = 5  # Gauss-Newton from a closed form: errors of 10 degrees are aligned to 1e-6 in three


def about_centroid(
    covariance: Float[np.ndarray, "camera 6 camera 6"], rig: CameraRig
) -> Float[np.ndarray, "camera 6 camera 6"]:
    """Covariance of what no similarity explains of the errors, from that in whatever gauge."""
    projection = onto_centroid(rig)
    flat = covariance.reshape(len(projection), len(projection))
    return (projection @ flat @ projection.T).reshape(covariance.shape)


def onto_centroid(rig: CameraRig, *, with_scale: bool = True) -> Float[np.ndarray, "error error"]:
    """The projection that leaves of the errors of all cameras what no similarity explains; without scale: what no
    motion explains, where the unit is known."""
    generators, weights = _generators(rig)[:, : 7 if with_scale else 6], _weights(rig)
    return np.eye(len(weights)) - generators @ np.linalg.pinv(weights[:, None] * generators) * weights


def point_about_centroid(
    covariance: Float[np.ndarray, "row row"], rig: CameraRig, point_m: Float[np.ndarray, " 3"]
) -> Float[np.ndarray, "3 3"]:
    """Covariance of a point after that similarity, which takes the cameras to where they are.

    Args:
        covariance: of the errors of all cameras, then of the point, in whatever gauge.
        rig: the cameras.
        point_m: where it is, in the frame and unit of the rig.
    """
    generators, weights, arm_m = _generators(rig), _weights(rig), point_m - _centre(rig)
    of_point = np.column_stack([np.cross(np.eye(3), arm_m).T, np.eye(3), arm_m])
    onto = np.hstack([-of_point @ np.linalg.pinv(weights[:, None] * generators) * weights, np.eye(3)])
    return onto @ covariance @ onto.T


def aligned(rig: CameraRig, onto: CameraRig) -> tuple[Similarity, Float[np.ndarray, "camera 6"]]:
    """The similarity that takes a rig nearest to another, and the errors that are left.

    Args:
        rig: the cameras, in any gauge.
        onto: the same ones in the gauge that is wanted.

    Returns:
        The similarity; and how each camera of onto has to be turned and moved, in its own frame and unit, to be where
        the moved one is.
    """
    similarity = _start(rig, onto)
    weights, generators = _weights(onto), _generators(onto)
    to_step = np.linalg.pinv(weights[:, None] * generators) * weights
    errors = _errors(rig, similarity, onto)
    for _ in range(_ROUNDS):
        nearer = _moved(similarity, -to_step @ errors.ravel(), _centre(onto))
        left = _errors(rig, nearer, onto)
        # Rigs that have nothing in common are as near as they were at the start.
        if not np.linalg.norm(weights * left.ravel()) < np.linalg.norm(weights * errors.ravel()):
            break
        similarity, errors = nearer, left
    return similarity, errors


def _start(rig: CameraRig, onto: CameraRig) -> Similarity:
    """The mean of the rotations, and the scale and shift that fit the positions then."""
    pairs = zip(rig.cameras, onto.cameras, strict=True)
    turns = sum((new.world_T_camera[:3, :3] @ old.world_T_camera[:3, :3].T for old, new in pairs), np.zeros((3, 3)))
    R = np.array(gtsam.Rot3.ClosestTo(turns).matrix())
    before, after = rig.positions_m @ R.T, onto.positions_m
    centre_before, centre_after = before.mean(axis=0), after.mean(axis=0)
    square = float(np.sum((before - centre_before) ** 2))
    scale = float(np.sum((before - centre_before) * (after - centre_after))) / square if square > 0 else 1.0
    # Where no rotation fits the positions, the sizes do.
    scale = scale if scale > 0 else float(np.sqrt(np.sum((after - centre_after) ** 2) / square))
    return Similarity(scale, R, centre_after - scale * centre_before)


def _moved(similarity: Similarity, step: Float[np.ndarray, " 7"], centre: Float[np.ndarray, " 3"]) -> Similarity:
    """After a further small similarity about a centre: rotation vector, shift, change of scale."""
    turn, grow = np.array(gtsam.Rot3.Expmap(step[:3]).matrix()), float(np.exp(np.clip(step[6], -1.0, 1.0)))
    offset = grow * turn @ (similarity.offset_m - centre) + centre + step[3:6]
    return Similarity(grow * similarity.scale, turn @ similarity.R, offset)


def _errors(rig: CameraRig, similarity: Similarity, onto: CameraRig) -> Float[np.ndarray, "camera 6"]:
    """Of the moved rig."""
    errors, positions = np.empty((rig.n_cameras, 6)), similarity.of(rig.positions_m)
    for c, (camera, true) in enumerate(zip(rig.cameras, onto.cameras, strict=True)):
        R = true.world_T_camera[:3, :3]
        turn = R.T @ similarity.R @ camera.world_T_camera[:3, :3]
        errors[c] = *gtsam.Rot3.Logmap(gtsam.Rot3(turn)), *(R.T @ (positions[c] - true.position_m))
    return errors


def _generators(rig: CameraRig) -> Float[np.ndarray, "error 7"]:
    """Errors that a small similarity about the centroid makes: rotation, shift, change of scale."""
    blocks = []
    for camera in rig.cameras:
        R, arm = camera.world_T_camera[:3, :3], camera.position_m - _centre(rig)
        block = np.zeros((6, 7))
        block[:3, :3], block[3:, 3:6] = R.T, R.T
        block[3:, :3] = R.T @ np.cross(np.eye(3), arm).T  # column k: e_k x arm
        block[3:, 6] = R.T @ arm
        blocks.append(block)
    return np.concatenate(blocks)


def _weights(rig: CameraRig) -> Float[np.ndarray, " error"]:
    size = float(np.sqrt(np.mean(np.sum((rig.positions_m - _centre(rig)) ** 2, axis=1))))
    return np.tile(np.repeat([1.0, 1.0 / size if size > 0 else 1.0], 3), rig.n_cameras)


def _centre(rig: CameraRig) -> Float[np.ndarray, " 3"]:
    return rig.positions_m.mean(axis=0)
