"""One rig laid on another, whose world may be any other: a calibration from people has its own."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.geometry.rigid import nearest_rotation


@dataclass(frozen=True, eq=False)
class Similarity:
    """Points of one world in another: scale * R @ point + offset."""

    scale: float
    R: Float[np.ndarray, "3 3"]
    offset_m: Float[np.ndarray, " 3"]

    def of(self, points_m: Float[np.ndarray, "*points 3"]) -> Float[np.ndarray, "*points 3"]:
        return self.scale * points_m @ self.R.T + self.offset_m

    def rig(self, rig: CameraRig) -> CameraRig:
        """The cameras moved; their images of moved points stay what they are."""
        return CameraRig(tuple(self._camera(camera) for camera in rig.cameras))

    def _camera(self, camera: Camera) -> Camera:
        world_T_camera = np.eye(4)
        world_T_camera[:3, :3] = self.R @ camera.world_T_camera[:3, :3]
        world_T_camera[:3, 3] = self.of(camera.position_m)
        return replace(camera, world_T_camera=world_T_camera)


def fitted(
    points_m: Float[np.ndarray, "point 3"], target_m: Float[np.ndarray, "point 3"], *, with_scale: bool = True
) -> Similarity:
    """The similarity that brings points closest to others in the least-squares sense (Umeyama, 1991); points that are
    NaN on either side are left out.

    Raises:
        ValueError: fewer than three points are known on both sides.
    """
    known = np.isfinite(points_m).all(axis=-1) & np.isfinite(target_m).all(axis=-1)
    if known.sum() < 3:
        raise ValueError(f"a similarity needs three points, {known.sum()} are known on both sides")
    source, target = points_m[known], target_m[known]
    source_mean, target_mean = source.mean(axis=0), target.mean(axis=0)
    source, target = source - source_mean, target - target_mean
    R, values = nearest_rotation(target.T @ source)
    scale = float(values.sum() / (source**2).sum()) if with_scale else 1.0
    return Similarity(scale, R, target_mean - scale * R @ source_mean)


def rig_similarity(rig: CameraRig, true_rig: CameraRig, *, with_scale: bool = True) -> Similarity:
    """From the world of a rig into that of the true one, cameras in the same order.

    Each camera counts with its place and with three points on its axes, as far from it as cameras are from the middle
    of their rig: so two cameras suffice, and three do not fit by their places alone whatever they are. A single camera
    leaves the scale at 1.
    """
    if rig.n_cameras == 1:
        with_scale = False
    return fitted(_with_axes(rig), _with_axes(true_rig), with_scale=with_scale)


def _with_axes(rig: CameraRig) -> Float[np.ndarray, "point 3"]:
    positions_m = rig.positions_m
    axes = np.stack([camera.world_T_camera[:3, :3].T for camera in rig.cameras])
    away_m = np.sqrt(np.mean(np.sum((positions_m - positions_m.mean(axis=0)) ** 2, axis=-1)))
    length_m = away_m if away_m > 0 else 1.0
    return np.concatenate([positions_m, (positions_m[:, None] + length_m * axes).reshape(-1, 3)])
