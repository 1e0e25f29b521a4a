"""Cameras that are changed: what the unknowns of the adjustment do to a rig, and what the changed cameras see."""

from __future__ import annotations

from dataclasses import dataclass, replace

import gtsam
import numpy as np
from jaxtyping import Bool, Float

from fgpose.calibration.adjustment.unknowns import CENTRE, FOCAL, OFFSET, POSE, RADIAL, ROTATION, TRANSLATION
from fgpose.geometry.camera import Camera, CameraRig
from fgpose_factors.projection import NEAREST_M


def adjusted_rig(rig: CameraRig, changes: Float[np.ndarray, "camera 11"]) -> CameraRig:
    """The rig with its cameras changed; see unknowns.N_OF_CAMERA."""
    return CameraRig(tuple(_changed(camera, own) for camera, own in zip(rig.cameras, changes, strict=True)))


@dataclass(frozen=True, eq=False)
class Views:
    """The changed cameras of a rig as arrays."""

    world_T_camera: Float[np.ndarray, "camera 4 4"]
    own_by_pose: Float[np.ndarray, "camera 6 6"]
    """How the changes of its pose turn and move a changed camera in its own frame."""
    focal_px: Float[np.ndarray, "camera 2"]
    centre_px: Float[np.ndarray, "camera 2"]
    diagonal_px: Float[np.ndarray, " camera"]
    k1: Float[np.ndarray, " camera"]

    @staticmethod
    def of(rig: CameraRig, changes: Float[np.ndarray, "camera 11"]) -> Views:
        focal_px = np.stack([np.diag(camera.K)[:2] for camera in rig.cameras])
        centre_px = np.stack([camera.K[:2, 2] for camera in rig.cameras])
        diagonal_px = np.array([_diagonal_px(camera) for camera in rig.cameras])
        own_by_pose = np.zeros((rig.n_cameras, 6, 6))
        for c, change in enumerate(changes):
            own_by_pose[c, ROTATION, ROTATION] = gtsam.Rot3.ExpmapDerivative(change[ROTATION])
            own_by_pose[c, TRANSLATION, TRANSLATION] = gtsam.Rot3.Expmap(change[ROTATION]).matrix().T
        return Views(
            world_T_camera=np.stack([_moved(*pair) for pair in zip(rig.cameras, changes, strict=True)]),
            own_by_pose=own_by_pose,
            focal_px=focal_px * np.exp(changes[:, FOCAL, None]),
            centre_px=centre_px + diagonal_px[:, None] * changes[:, CENTRE],
            diagonal_px=diagonal_px,
            k1=changes[:, RADIAL],
        )


@dataclass(frozen=True, eq=False)
class Jacobians:
    """Of pixels; at or behind a camera they are zero."""

    by_joint: Float[np.ndarray, "frame camera joint 2 3"]
    by_camera: Float[np.ndarray, "frame camera joint 2 10"]
    """All changes of a camera but the time offset."""
    by_bias: Float[np.ndarray, "frame camera joint 2 2"]


class Projection:
    """Where the cameras see joints that they take to be somewhat beside where they are.

    Args:
        joints_m: world frame.
        bias_m: along the axes of the image, metres at the joint.
        views: the cameras. Radial distortion is f n (1 + k1 |n|^2) of a point n at unit focal length, in pixels that
            are undistorted otherwise.
    """

    points_px: Float[np.ndarray, "frame camera joint 2"]
    in_front: Bool[np.ndarray, "frame camera joint"]

    def __init__(
        self,
        joints_m: Float[np.ndarray, "frame joint 3"],
        bias_m: Float[np.ndarray, "frame camera joint 2"],
        views: Views,
    ) -> None:
        self._views = views
        self._own_m = (joints_m[:, None] - views.world_T_camera[:, None, :3, 3]) @ views.world_T_camera[:, :3, :3]
        depth_m = self._own_m[..., 2]
        self.in_front = depth_m > NEAREST_M
        self._depth_m = np.where(self.in_front, depth_m, 1.0)
        at_unit = (self._own_m[..., :2] + bias_m) / self._depth_m[..., None]
        self._at_unit = np.where(self.in_front[..., None], at_unit, 0.0)
        self._squared = np.sum(self._at_unit**2, axis=-1)
        self._stretch = 1 + views.k1[:, None] * self._squared
        self._from_centre_px = views.focal_px[:, None] * self._at_unit * self._stretch[..., None]
        self.points_px = self._from_centre_px + views.centre_px[:, None]

    def jacobians(self) -> Jacobians:
        # p = Exp(-w) R' (x - p0) - t for small w and t in the frame of the camera, so that dp/dw = [p]x and dp/dt = -1.
        views, at_unit = self._views, self._at_unit
        focal_px, in_front = views.focal_px[:, None], self.in_front[..., None, None]
        by_unit = self._stretch[..., None, None] * np.eye(2) + 2 * views.k1[:, None, None, None] * _outer(at_unit)
        by_bias = np.where(in_front, focal_px[..., None] * by_unit, 0.0) / self._depth_m[..., None, None]
        by_own = np.concatenate([by_bias, -np.sum(by_bias * at_unit[..., None, :], axis=-1, keepdims=True)], axis=-1)
        by_pose = np.concatenate([_times_cross(by_own, self._own_m), -by_own], axis=-1) @ views.own_by_pose[:, None]
        by_lens = np.stack([self._from_centre_px, focal_px * at_unit * self._squared[..., None]], axis=-1)
        by_centre = in_front * views.diagonal_px[:, None, None, None] * np.eye(2)
        return Jacobians(
            by_joint=by_own @ views.world_T_camera[:, :3, :3].swapaxes(-1, -2)[:, None],
            by_camera=np.concatenate([by_pose, by_lens, by_centre], axis=-1),
            by_bias=by_bias,
        )


def _changed(camera: Camera, change: Float[np.ndarray, " 11"]) -> Camera:
    K, ratio = camera.K.copy(), float(np.exp(change[FOCAL]))
    K[[0, 1], [0, 1]] *= ratio
    K[:2, 2] += _diagonal_px(camera) * change[CENTRE]
    distortion = _rescaled(camera.distortion, ratio)
    if change[RADIAL]:
        distortion = np.array([change[RADIAL], 0.0, 0.0, 0.0])
    return replace(
        camera,
        K=K,
        world_T_camera=_moved(camera, change),
        distortion=distortion,
        time_offset_s=camera.time_offset_s + float(change[OFFSET]),
    )


def _moved(camera: Camera, change: Float[np.ndarray, " 11"]) -> Float[np.ndarray, "4 4"]:
    world_T_camera = camera.world_T_camera.copy()
    if change[POSE].any():  # what is held stays to the last digit
        world_T_camera[:3, 3] += world_T_camera[:3, :3] @ change[TRANSLATION]
        world_T_camera[:3, :3] = world_T_camera[:3, :3] @ gtsam.Rot3.Expmap(change[ROTATION]).matrix()
    return world_T_camera


def _diagonal_px(camera: Camera) -> float:
    return float(np.hypot(*camera.size_px))


def _rescaled(distortion: Float[np.ndarray, " coefficients"], ratio: float) -> Float[np.ndarray, " coefficients"]:
    """The same displacements in pixels at a focal length that is larger by a ratio: k r^2 with r in focal lengths."""
    powers = np.array([2, 4, 1, 1, 6, 2, 4, 6])[: distortion.size]
    return distortion * ratio ** powers.astype(float)


def _outer(vectors: Float[np.ndarray, "*points 2"]) -> Float[np.ndarray, "*points 2 2"]:
    return vectors[..., :, None] * vectors[..., None, :]


def _times_cross(
    rows: Float[np.ndarray, "*points 2 3"], points_m: Float[np.ndarray, "*points 3"]
) -> Float[np.ndarray, "*points 2 3"]:
    """rows @ [p]x, which is rows x p for each row: (a' [p]x) b = a . (p x b) = (a x p) . b."""
    return np.cross(rows, points_m[..., None, :])
