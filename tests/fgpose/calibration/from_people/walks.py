"""Walks of one person on a circle before several cameras, with the errors of a network, for tests."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from fgpose.assessment.rigs import angle_deg
from fgpose.calibration.from_people.walk import Walk
from fgpose.geometry.camera import CameraRig
from fgpose.io.skeletons import load_skeleton
from fgpose_benchmarks.synthetic import NO_NOISE, NO_OCCLUSION, DetectionNoise, simulate, walking

FPS = 30.0
SKELETON = load_skeleton("h36m_17")


def walk(
    rig: CameraRig,
    n_frames: int = 240,
    noise: DetectionNoise = NO_NOISE,
    bias_m: float = 0.0,
    views_3d: bool = False,
    offsets_s: Float[np.ndarray, " camera"] | None = None,
    seed: int = 0,
) -> Walk:
    """What the cameras of a rig saw of a walker.

    Args:
        bias_m: length of the error of each joint in the image, at the joint, which depends on the direction from which
            the body is seen, alike in all cameras, and turns with it.
        views_3d: with the 3D of each view, turned by several degrees as a whole.
        offsets_s: how much later than the walk says the cameras saw it.
    """
    truth_m = walking(n_frames, FPS, SKELETON)
    seen = simulate(truth_m, SKELETON, rig, FPS, noise, NO_OCCLUSION, seed, offsets_s).observations
    points_px = seen.points2d_px + bias_m * _bias_px_per_m(truth_m, rig, seed)
    points3d_m = _own_3d_m(seen.points3d_m, rig) if views_3d and seen.points3d_m is not None else None
    return Walk(SKELETON, rig.names, seen.time_s.copy(), points_px, seen.confidence.copy(), points3d_m)


def bare(rig: CameraRig, ratio: float = 1.0) -> CameraRig:
    """Intrinsics alone, the focal lengths guessed so many times too large."""
    scale = np.diag([ratio, ratio, 1.0])
    cameras = []
    for camera in rig.cameras:
        K = camera.K @ scale
        K[:2, 2] = camera.K[:2, 2]
        cameras.append(replace(camera, K=K, world_T_camera=np.eye(4)))
    return CameraRig(tuple(cameras))


def rotation_errors_deg(found: CameraRig, true: CameraRig) -> Float[np.ndarray, " camera"]:
    """Of each camera relative to the first."""
    errors = []
    for c in range(true.n_cameras):
        relative = [
            rig.cameras[0].world_T_camera[:3, :3].T @ rig.cameras[c].world_T_camera[:3, :3] for rig in (found, true)
        ]
        errors.append(angle_deg(*relative))
    return np.array(errors)


def position_errors_m(found: CameraRig, true: CameraRig) -> Float[np.ndarray, " camera"]:
    """After the similarity that fits the positions best (Umeyama 1991)."""
    ours, theirs = (np.stack([camera.position_m for camera in rig.cameras]) for rig in (found, true))
    a, b = ours - ours.mean(axis=0), theirs - theirs.mean(axis=0)
    u, sizes, vt = np.linalg.svd(b.T @ a)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    scale = float(sizes @ signs) / float(np.sum(a**2))
    return np.linalg.norm(scale * a @ (u @ np.diag(signs) @ vt).T - b, axis=1)


def _bias_px_per_m(
    truth_m: Float[np.ndarray, "frame joint 3"], rig: CameraRig, seed: int
) -> Float[np.ndarray, "frame camera joint 2"]:
    rng = np.random.default_rng(seed)
    phases, turns = rng.uniform(0, 2 * np.pi, SKELETON.n_joints), rng.choice([-1, 1], SKELETON.n_joints)
    to_left = truth_m[:, SKELETON.index("left_hip")] - truth_m[:, SKELETON.index("right_hip")]
    heading = np.arctan2(-to_left[:, 0], to_left[:, 1])
    views = []
    for camera in rig.cameras:
        to_camera = camera.position_m - truth_m[:, SKELETON.index("pelvis")]
        seen_from = np.arctan2(to_camera[:, 1], to_camera[:, 0]) - heading
        angle = phases + turns * seen_from[:, None]
        depth_m = camera.to_camera_frame(truth_m)[..., 2]
        views.append(camera.K[0, 0] / depth_m[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1))
    return np.stack(views, axis=1)


def _own_3d_m(
    points3d_m: Float[np.ndarray, "frame camera joint 3"], rig: CameraRig
) -> Float[np.ndarray, "frame camera joint 3"]:
    """In the frame of each camera, turned by 6 degrees about the image's x, y or z around the body."""
    from scipy.spatial.transform import Rotation

    views_m = []
    for c, camera in enumerate(rig.cameras):
        own_m = camera.to_camera_frame(points3d_m[:, c])
        centre_m = own_m.mean(axis=1, keepdims=True)
        turn = Rotation.from_rotvec(np.deg2rad(6.0) * np.eye(3)[c % 3]).as_matrix()
        views_m.append((own_m - centre_m) @ turn.T + centre_m)
    return np.stack(views_m, axis=1)
