"""Similarity transformations of a rig: what a calibration from images alone leaves open."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from fgpose.geometry.camera import Camera, CameraRig


@dataclass(frozen=True, eq=False)
class Similarity:
    """Points of one gauge in another: scale * R @ point + offset."""

    scale: float
    R: Float[np.ndarray, "3 3"]
    offset_m: Float[np.ndarray, 3]

    def of(self, points: Float[np.ndarray, "*points 3"]) -> Float[np.ndarray, "*points 3"]:
        return self.scale * points @ self.R.T + self.offset_m

    def rig(self, rig: CameraRig) -> CameraRig:
        """The cameras moved; their images of moved points stay what they are."""
        return CameraRig(tuple(self._camera(camera) for camera in rig.cameras))

    def _camera(self, camera: Camera) -> Camera:
        world_T_camera = np.eye(4)
        world_T_camera[:3, :3] = self.R @ camera.world_T_camera[:3, :3]
        world_T_camera[:3, 3] = self.of(camera.position_m)
        return replace(camera, world_T_camera=world_T_camera)
