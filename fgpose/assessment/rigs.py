"""How good an estimated rig is beside the true one: by its cameras, and by what it does to the people in it.

Angles in degrees, lengths in metres. Cameras are in the same order on both sides.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from jaxtyping import Float

from fgpose.assessment.rig_alignment import fitted, rig_similarity
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.triangulation import triangulate


def position_errors_m(rig: CameraRig, true_rig: CameraRig) -> Float[np.ndarray, " camera"]:
    """Distance of each camera from its true place, after the similarity of the rigs."""
    places_m, true_m = (each.positions_m for each in (rig, true_rig))
    return np.linalg.norm(rig_similarity(rig, true_rig).of(places_m) - true_m, axis=-1)


def direction_errors_deg(rig: CameraRig, true_rig: CameraRig) -> Float[np.ndarray, " camera"]:
    """Angle by which each camera is turned, after the similarity of the rigs."""
    R = rig_similarity(rig, true_rig).R
    pairs = zip(_rotations(rig), _rotations(true_rig), strict=True)
    return np.array([angle_deg(R @ own, true) for own, true in pairs])


def rotation_errors_deg(rig: CameraRig, true_rig: CameraRig) -> Float[np.ndarray, " pair"]:
    """Error of the rotation between the cameras of each pair. It needs no alignment."""
    own, true = _rotations(rig), _rotations(true_rig)
    pairs = combinations(range(rig.n_cameras), 2)
    return np.array([angle_deg(own[a].T @ own[b], true[a].T @ true[b]) for a, b in pairs])


def scale_error(rig: CameraRig, true_rig: CameraRig) -> float:
    """How much too large the rig is, as a share; negative: too small."""
    return 1.0 / rig_similarity(rig, true_rig).scale - 1.0


def vertical_error_deg(rig: CameraRig, true_rig: CameraRig) -> float:
    """Angle between the z axes of the two worlds."""
    up = rig_similarity(rig, true_rig).R[:, 2]
    return float(np.rad2deg(np.arctan2(np.linalg.norm(up[:2]), up[2])))


def floor_error_m(rig: CameraRig, true_rig: CameraRig, around_m: Float[np.ndarray, " 3"]) -> float:
    """Height of the floor (z = 0) of the rig's world over the true floor, under a point of the true world.

    After the similarity of the rigs: an error of scale does not count, one of the vertical counts as far as the point
    is away from the middle of the cameras.
    """
    aligned = rig_similarity(rig, true_rig)
    in_rig_m = (around_m - aligned.offset_m) @ aligned.R / aligned.scale
    return float(aligned.of(in_rig_m * np.array([1.0, 1.0, 0.0]))[2])


def focal_errors(rig: CameraRig, true_rig: CameraRig) -> Float[np.ndarray, " camera"]:
    """Error of each focal length (geometric mean over the axes), as a share of it."""
    return rig.focal_px / true_rig.focal_px - 1.0


def start_errors_s(rig: CameraRig, true_rig: CameraRig) -> Float[np.ndarray, " camera"]:
    """Error of each camera's time offset from the first; zero for the first."""
    own_s, true_s = rig.time_offsets_s, true_rig.time_offsets_s
    return (own_s - own_s[0]) - (true_s - true_s[0])


def induced_errors_m(
    rig: CameraRig, true_rig: CameraRig, joints_m: Float[np.ndarray, "frame joint 3"]
) -> Float[np.ndarray, "frame joint"]:
    """What the calibration alone does to true joints: exact detections in all true cameras that have them in the
    image, triangulated with the rig, and the distance from the truth after a similarity.

    NaN where fewer than two cameras see a joint. All NaN where fewer than three joints remain.
    """
    return _off(seen_through_m(rig, true_rig, joints_m), joints_m)


def seen_through_m(
    rig: CameraRig, true_rig: CameraRig, joints_m: Float[np.ndarray, "frame joint 3"]
) -> Float[np.ndarray, "frame joint 3"]:
    """True joints as exact detections and the rig give them, in the world of the rig; NaN: fewer than two cameras."""
    own_px = []
    for camera, true_camera in zip(rig.cameras, true_rig.cameras, strict=True):
        true_px = true_camera.project(joints_m)
        original_px = true_camera.distort(true_px)
        shown = np.all((original_px >= 0) & (original_px < true_camera.size_px), axis=-1)
        own_px.append(camera.undistort(np.where(shown[..., None], original_px, np.nan)))
    points_px = np.stack(own_px, axis=-2)
    return triangulate(points_px, np.ones(points_px.shape[:-1]), rig.projection_matrices)


def _off(
    found_m: Float[np.ndarray, "frame joint 3"], true_m: Float[np.ndarray, "frame joint 3"]
) -> Float[np.ndarray, "frame joint"]:
    """Distances after the best similarity of all points together."""
    try:
        aligned = fitted(found_m.reshape(-1, 3), true_m.reshape(-1, 3))
    except ValueError:
        return np.full(found_m.shape[:-1], np.nan)
    return np.linalg.norm(aligned.of(found_m) - true_m, axis=-1)


def _rotations(rig: CameraRig) -> list[np.ndarray]:
    return [camera.world_T_camera[:3, :3] for camera in rig.cameras]


def angle_deg(R: Float[np.ndarray, "3 3"], other: Float[np.ndarray, "3 3"]) -> float:
    """Of the rotation from one to the other; exact for small angles, unlike the arccosine of the trace."""
    from scipy.spatial.transform import Rotation

    return float(np.rad2deg(Rotation.from_matrix(R.T @ other).magnitude()))
