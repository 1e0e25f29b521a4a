"""What judges a rig without having made it: views left out in turn, and the network's own 3D."""

from __future__ import annotations

import gtsam
import numpy as np
from jaxtyping import Float

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.geometry.triangulation import triangulate


def third_view_mrad(
    undistorted_px: Float[np.ndarray, "frame camera joint 2"],
    confidence: Float[np.ndarray, "frame camera joint"],
    rig: CameraRig,
) -> Float[np.ndarray, " camera"]:
    """Of each camera the median angle between its detections and where the other cameras have the joints.

    Two cameras have no third view: there it is the angle out of the epipolar plane.

    Args:
        undistorted_px: of frames that the calibration was not made from, where there are some: those that made it
            agree by construction.
        confidence: 0 = missing.
        rig: the cameras.

    Returns:
        Milliradians; NaN where a camera has no detection of a joint that enough others see.
    """
    px = np.where(confidence[..., None] > 0, undistorted_px, np.nan)
    if rig.n_cameras == 2:
        return _epipolar_mrad(px, rig)
    return np.array([_left_out_mrad(c, px, confidence, rig) for c in range(rig.n_cameras)])


def _left_out_mrad(
    left_out: int,
    px: Float[np.ndarray, "frame camera joint 2"],
    confidence: Float[np.ndarray, "frame camera joint"],
    rig: CameraRig,
) -> float:
    others = [c for c in range(rig.n_cameras) if c != left_out]
    # No search for inliers: where the others do not agree, what is left would flatter them.
    joints_m = triangulate(
        px[:, others].swapaxes(1, 2), confidence[:, others].swapaxes(1, 2), rig.projection_matrices[others]
    )
    camera = rig.cameras[left_out]
    there = joints_m - camera.position_m
    cosine = np.sum(camera.ray(px[:, left_out]) * there, axis=-1) / np.linalg.norm(there, axis=-1)
    return _median_mrad(np.arccos(np.clip(cosine, -1.0, 1.0)))


def _epipolar_mrad(px: Float[np.ndarray, "frame camera joint 2"], rig: CameraRig) -> Float[np.ndarray, " camera"]:
    rays = [camera.ray(px[:, c]) for c, camera in enumerate(rig.cameras)]
    baseline = rig.cameras[1].position_m - rig.cameras[0].position_m
    angles = []
    for own, other in ((0, 1), (1, 0)):
        normal = np.cross(baseline, rays[other])
        length = np.linalg.norm(normal, axis=-1)
        sine = np.sum(rays[own] * normal, axis=-1) / np.where(length > 0, length, np.nan)
        angles.append(_median_mrad(np.arcsin(np.clip(np.abs(sine), 0.0, 1.0))))
    return np.array(angles)


def _median_mrad(angle_rad: np.ndarray) -> float:
    known = angle_rad[np.isfinite(angle_rad)]
    return 1e3 * float(np.median(known)) if known.size else float("nan")


def referee_deg(
    points3d_m: Float[np.ndarray, "frame camera joint 3"], joints_m: Float[np.ndarray, "frame joint 3"], rig: CameraRig
) -> Float[np.ndarray, " camera"]:
    """By how much each camera would have to be turned for the poses to look as its network sees them, degrees.

    The rotation that takes the poses (around their middle) of the network's 3D to the reconstructed ones, over all
    frames (Kabsch). Networks are 5 to 15 degrees off, but never twisted, as a five-point solution may be.

    Args:
        points3d_m: of each view, in the frame of its camera; NaN = missing.
        joints_m: the reconstructed ones, in the frame of the rig.
        rig: the cameras.

    Returns:
        NaN where there is no 3D.
    """
    pairs = enumerate(rig.cameras)
    return np.array([_turned_deg(points3d_m[:, c], joints_m, camera) for c, camera in pairs])


def _turned_deg(
    seen_m: Float[np.ndarray, "frame joint 3"], joints_m: Float[np.ndarray, "frame joint 3"], camera: Camera
) -> float:
    own_m = camera.to_camera_frame(joints_m)
    known = (np.isfinite(seen_m) & np.isfinite(own_m)).all(axis=-1)
    several = known.sum(axis=1) >= 4
    if not several.any():
        return float("nan")
    products = np.zeros((3, 3))
    for frame in np.flatnonzero(several):
        used = known[frame]
        seen, own = seen_m[frame, used], own_m[frame, used]
        products += (seen - seen.mean(axis=0)).T @ (own - own.mean(axis=0))
    turn = gtsam.Rot3.ClosestTo(products)
    return float(np.rad2deg(np.linalg.norm(gtsam.Rot3.Logmap(turn))))
