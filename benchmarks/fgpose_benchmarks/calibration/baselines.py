"""What others begin with: Procrustes of per-view 3D poses, and the five-point algorithm. Both are told who is who and
when each image was taken, and neither refines."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from fgpose.assessment.rig_alignment import Similarity, fitted
from fgpose.calibration.from_people.walk import Walk
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.triangulation import triangulate

_KEPT_QUANTILE = 0.8
"""Of the joints after the first fit, as HumanCalib drops outlier frames; a fifth are outliers in hard recordings."""
_INLIER_PX = 8.0
"""Of RANSAC: a detection is off by 3 to 6 px at the default noise, more with a bias."""


def procrustes(walk: Walk, intrinsics: CameraRig) -> CameraRig:
    """The rigid motion that lays each camera's 3D joints on the first's (what HumanCalib starts from).

    Raises:
        ValueError: there is no per-view 3D, or a camera shares fewer than three joints with the first.
    """
    if walk.points3d_m is None:
        raise ValueError("Procrustes needs per-view 3D joints")
    cameras = [intrinsics.cameras[0]]
    for c, camera in enumerate(intrinsics.cameras[1:], start=1):
        first_m, own_m = (walk.points3d_m[:, number].reshape(-1, 3) for number in (0, c))
        motion = fitted(own_m, first_m, with_scale=False)
        off_m = np.linalg.norm(motion.of(own_m) - first_m, axis=-1)
        near = off_m <= np.nanquantile(off_m, _KEPT_QUANTILE)
        motion = fitted(own_m[near], first_m[near], with_scale=False)
        cameras.append(replace(camera, world_T_camera=_pose(motion)))
    return CameraRig(tuple(cameras))


def _pose(motion: Similarity) -> Float[np.ndarray, "4 4"]:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = motion.R, motion.offset_m
    return pose


def five_point(walk: Walk, intrinsics: CameraRig) -> CameraRig:
    """The two cameras with most joints in common by the five-point algorithm, the others by PnP on their joints. The
    distance of the two is 1.

    Raises:
        ValueError: a camera shares too few joints with them.
    """
    slopes = _slopes(walk, intrinsics)
    flat = np.moveaxis(slopes, 1, 0).reshape(len(slopes[0]), -1, 2)
    known = np.asarray(np.isfinite(flat).all(axis=-1))
    common = known.astype(int) @ known.T.astype(int)
    np.fill_diagonal(common, -1)
    a, b = (int(number) for number in np.unravel_index(int(common.argmax()), common.shape))
    poses = {
        a: np.eye(4),
        b: _second_pose(flat[a], flat[b], known[a] & known[b], float(intrinsics.focal_px[[a, b]].mean())),
    }
    projections = np.stack([np.linalg.inv(poses[number])[:3] for number in (a, b)])
    points_m = triangulate(flat[[a, b]].swapaxes(0, 1), np.ones((flat.shape[1], 2)), projections)
    for c in set(range(len(flat))) - {a, b}:
        seen = known[c] & np.isfinite(points_m).all(axis=-1)
        if seen.sum() < 6:
            raise ValueError(f"camera {intrinsics.names[c]} shares too few joints with two others")
        poses[c] = _pose_by_pnp(points_m[seen], flat[c][seen], float(intrinsics.focal_px[c]))
    to_first = np.linalg.inv(poses[0])
    return CameraRig(
        tuple(replace(camera, world_T_camera=to_first @ poses[c]) for c, camera in enumerate(intrinsics.cameras))
    )


def _slopes(walk: Walk, intrinsics: CameraRig) -> Float[np.ndarray, "frame camera joint 2"]:
    """Undistorted points at unit focal length."""
    K = intrinsics.K[:, None]
    focal_px = np.stack([K[..., 0, 0], K[..., 1, 1]], axis=-1)
    return (intrinsics.undistort(walk.points2d_px) - K[..., :2, 2]) / focal_px


def _second_pose(
    first: Float[np.ndarray, "point 2"], second: Float[np.ndarray, "point 2"], both: np.ndarray, focal_px: float
) -> Float[np.ndarray, "4 4"]:
    """Pose of the second camera in the frame of the first, at unit distance."""
    import cv2

    if both.sum() < 8:
        raise ValueError("no two cameras share enough joints")
    pair = first[both], second[both]
    cv2.setRNGSeed(0)
    E, inliers = cv2.findEssentialMat(*pair, np.eye(3), cv2.USAC_MAGSAC, 0.999, _INLIER_PX / focal_px)
    if E is None or E.shape != (3, 3):
        raise ValueError("the five-point algorithm finds no essential matrix")
    _, R, offset, _ = cv2.recoverPose(E, *pair, np.eye(3), mask=inliers)
    return np.linalg.inv(_matrix(R, offset[:, 0]))


def _pose_by_pnp(
    points_m: Float[np.ndarray, "point 3"], slopes: Float[np.ndarray, "point 2"], focal_px: float
) -> Float[np.ndarray, "4 4"]:
    """Pose of a camera that sees known points."""
    import cv2

    limit = _INLIER_PX / focal_px
    _, turn, offset, _ = cv2.solvePnPRansac(
        points_m, slopes, np.eye(3), None, iterationsCount=500, reprojectionError=limit
    )
    return np.linalg.inv(_matrix(cv2.Rodrigues(turn)[0], offset[:, 0]))


def _matrix(R: Float[np.ndarray, "3 3"], offset: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "4 4"]:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = R, offset
    return matrix
