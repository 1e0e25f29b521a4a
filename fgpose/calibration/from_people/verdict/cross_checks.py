"""What judges a rig without having made it: views left out in turn, and the network's own 3D."""

from __future__ import annotations

import gtsam
import numpy as np
from jaxtyping import Float

from fgpose.estimation.evidence.presence import MIN_JOINTS
from fgpose.geometry.camera import Camera, CameraRig
from fgpose.geometry.triangulation import triangulate
from fgpose_factors.robust_statistics import known_median

_FEWEST = 6  # joints of a frame that tell by how much a body is turned and scaled


def third_views_mrad(
    undistorted_px: Float[np.ndarray, "frame camera joint 2"],
    confidence: Float[np.ndarray, "frame camera joint"],
    rig: CameraRig,
) -> Float[np.ndarray, "camera frame"]:
    """How far each camera sees the body from where the other cameras have it, frame by frame.

    Of each frame the part of the offsets counts that moves, turns or scales the whole body in the image: a detector
    places every joint somewhere else, depending on the view, and a wrong camera moves them all. Joints count by their
    confidence, for those that are hidden are guessed. Two cameras have no third view: there it is by how much the body
    is out of the epipolar planes.

    Args:
        undistorted_px: of frames that the calibration was not made from, where there are some: those that made it
            agree by construction.
        confidence: 0 = missing.
        rig: the cameras.

    Returns:
        Milliradians; NaN where a camera does not see six joints that enough others see.
    """
    return np.stack([third_view_of(c, undistorted_px, confidence, rig) for c in range(rig.n_cameras)])


def medians_mrad(third_mrad: Float[np.ndarray, "camera frame"]) -> Float[np.ndarray, " camera"]:
    """Of third_views_mrad; NaN of a camera of which nothing is known."""
    return np.array([known_median(own) for own in third_mrad])


def third_view_of(
    camera: int,
    undistorted_px: Float[np.ndarray, "frame camera joint 2"],
    confidence: Float[np.ndarray, "frame camera joint"],
    rig: CameraRig,
) -> Float[np.ndarray, " frame"]:
    """third_views_mrad of one camera."""
    px = np.where(confidence[..., None] > 0, undistorted_px, np.nan)
    if rig.n_cameras == 2:
        return 1e3 * _out_of_plane_rad(camera, px, rig)
    return 1e3 * _left_out_rad(camera, px, confidence, rig)


def _left_out_rad(
    left_out: int,
    px: Float[np.ndarray, "frame camera joint 2"],
    confidence: Float[np.ndarray, "frame camera joint"],
    rig: CameraRig,
) -> Float[np.ndarray, " frame"]:
    others = [c for c in range(rig.n_cameras) if c != left_out]
    # No search for inliers: where the others do not agree, what is left would flatter them.
    joints_m = triangulate(
        px[:, others].swapaxes(1, 2), confidence[:, others].swapaxes(1, 2), rig.projection_matrices[others]
    )
    camera = rig.cameras[left_out]
    focal_px, centre_px = np.diag(camera.K)[:2], camera.K[:2, 2]
    seen, there = (px[:, left_out] - centre_px) / focal_px, (camera.project(joints_m) - centre_px) / focal_px
    known = np.asarray((np.isfinite(seen) & np.isfinite(there)).all(axis=-1))
    weights = confidence[:, left_out] * confidence[:, others].max(axis=1)
    offset_rad = np.full(len(known), np.nan)
    for t in np.flatnonzero(known.sum(axis=1) >= _FEWEST):
        offset_rad[t] = _body_offset(seen[t, known[t]], there[t, known[t]], weights[t, known[t]])
    return offset_rad


def _body_offset(
    seen: Float[np.ndarray, "joint 2"], there: Float[np.ndarray, "joint 2"], weights: Float[np.ndarray, " joint"]
) -> float:
    """Root mean square of what a shift, a turn and a scaling of the image move the joints by, in focal lengths: the
    least-squares similarity, whose turn and scale are one complex number."""
    share = weights / weights.sum()
    points, offsets = seen @ (1, 1j), (there - seen) @ (1, 1j)
    around, shift = points - share @ points, share @ offsets
    square = float(share @ np.abs(around) ** 2)
    grow = (share * around.conj()) @ (offsets - shift) / square if square > 0 else 0.0
    return float(np.sqrt(share @ np.abs(shift + grow * around) ** 2))


def _out_of_plane_rad(
    own: int, px: Float[np.ndarray, "frame camera=2 joint 2"], rig: CameraRig
) -> Float[np.ndarray, " frame"]:
    """By how much the body is out of the epipolar planes of the other camera: median over the joints."""
    rays = [camera.ray(px[:, c]) for c, camera in enumerate(rig.cameras)]
    normal = np.cross(rig.cameras[1].position_m - rig.cameras[0].position_m, rays[1 - own])
    length = np.linalg.norm(normal, axis=-1)
    out_rad = np.arcsin(np.clip(np.sum(rays[own] * normal, axis=-1) / np.where(length > 0, length, np.nan), -1, 1))
    known = np.isfinite(out_rad)
    offset_rad = np.full(len(known), np.nan)
    for t in np.flatnonzero(known.sum(axis=1) >= _FEWEST):
        offset_rad[t] = abs(np.median(out_rad[t, known[t]]))
    return offset_rad


def cross_check_deg(
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
    known = np.asarray((np.isfinite(seen_m) & np.isfinite(own_m)).all(axis=-1))
    several = known.sum(axis=1) >= MIN_JOINTS
    if not several.any():
        return float("nan")
    products = np.zeros((3, 3))
    for frame in np.flatnonzero(several):
        used = known[frame]
        seen, own = seen_m[frame, used], own_m[frame, used]
        products += (seen - seen.mean(axis=0)).T @ (own - own.mean(axis=0))
    turn = gtsam.Rot3.ClosestTo(products)
    return float(np.rad2deg(np.linalg.norm(gtsam.Rot3.Logmap(turn))))
