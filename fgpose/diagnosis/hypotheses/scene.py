"""What the cameras saw and how they stand, in a form in which either is quickly changed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.skeleton import Skeleton

# Joints that all detectors mark at about the same place, and that no hat, hair or shoe moves.
_LIMB_JOINTS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
_MOST_JOINTS = 12
_FEW_FRAMES = 3


@dataclass(frozen=True, eq=False)
class CameraView:
    """One camera and what it saw."""

    camera: Camera
    points_px: Float[np.ndarray, "frame joint 2"]
    """In the original, distorted image; NaN = missing."""

    @cached_property
    def in_camera(self) -> Float[np.ndarray, "frame joint 3"]:
        """Unit directions in the camera's frame."""
        undistorted_px = self.camera.undistort(self.points_px)
        normalized = (undistorted_px - self.camera.K[:2, 2]) / np.diag(self.camera.K)[:2]
        rays = np.concatenate([normalized, np.ones((*normalized.shape[:-1], 1))], axis=-1)
        return rays / np.linalg.norm(rays, axis=-1, keepdims=True)

    @cached_property
    def rays(self) -> Float[np.ndarray, "frame joint 3"]:
        """Unit directions in the world frame."""
        return self.in_camera @ self.camera.world_T_camera[:3, :3].T

    def at(self, world_T_camera: Float[np.ndarray, "4 4"]) -> CameraView:
        """The same, seen from somewhere else."""
        moved = CameraView(replace(self.camera, world_T_camera=world_T_camera), self.points_px)
        moved.__dict__["in_camera"] = self.in_camera
        return moved

    def with_points(self, points_px: Float[np.ndarray, "frame joint 2"]) -> CameraView:
        return CameraView(self.camera, points_px)

    def joints(self, joints: Int[np.ndarray, " joint"]) -> CameraView:
        """Some of the joints, or all in another order."""
        return self._part((slice(None), joints))

    def frames(self, frames: Int[np.ndarray, " sample"]) -> CameraView:
        return self._part((frames,))

    def _part(self, chosen: tuple[Any, ...]) -> CameraView:
        part = CameraView(self.camera, self.points_px[chosen])
        if "in_camera" in self.__dict__:
            part.__dict__["in_camera"] = self.in_camera[chosen]
        return part


@dataclass(frozen=True, eq=False)
class SynchronousViews:
    """All cameras at the same moments."""

    views: tuple[CameraView, ...]
    mirror: Int[np.ndarray, " joint"]
    """For each joint, the one on the other side of the body."""
    limbs: Int[np.ndarray, "limb side 2"]
    """Joints at both ends of each limb, of the left side and of the right one."""
    time_s: Float[np.ndarray, " frame"]
    shrunk: float = 1.0
    """By how much a hypothesis has made the body, and with it all distances, smaller than it is as given."""

    @staticmethod
    def of(
        rig: CameraRig,
        points_px: Float[np.ndarray, "frame camera joint 2"],
        skeleton: Skeleton,
        time_s: Float[np.ndarray, " frame"],
    ) -> SynchronousViews:
        """All joints of all frames."""
        views = [CameraView(camera, points_px[:, c]) for c, camera in enumerate(rig.cameras)]
        limbs = np.array(skeleton.limb_pairs, dtype=int).reshape(-1, 2, 2)
        return SynchronousViews(tuple(views), skeleton.mirror, limbs, time_s)

    @property
    def n_cameras(self) -> int:
        return len(self.views)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(view.camera.name for view in self.views)

    @cached_property
    def rays(self) -> Float[np.ndarray, "frame joint camera 3"]:
        return np.stack([view.rays for view in self.views], axis=2)

    @cached_property
    def seen(self) -> Bool[np.ndarray, "frame joint camera"]:
        """Which joints were detected, be it where the lens cannot have shown them: there they have no ray."""
        return np.stack([np.isfinite(view.points_px).all(axis=-1) for view in self.views], axis=2)

    @property
    def shows_limbs(self) -> bool:
        """Whether two cameras see some limb of both sides in a few frames."""
        if not len(self.limbs):
            return False
        by_two = self.seen.sum(axis=-1) >= 2
        whole = by_two[:, self.limbs[..., 0]] & by_two[:, self.limbs[..., 1]]
        return bool((whole.sum(axis=0) >= _FEW_FRAMES).all(axis=-1).any())

    @cached_property
    def origins_m(self) -> Float[np.ndarray, "camera 3"]:
        return np.stack([view.camera.position_m for view in self.views])

    def frames(self, frames: Int[np.ndarray, " sample"]) -> SynchronousViews:
        views = tuple(view.frames(frames) for view in self.views)
        return replace(self, views=views, time_s=self.time_s[frames])

    def joints(self, joints: Int[np.ndarray, " joint"]) -> SynchronousViews:
        """Some of the joints; those of the other side have to be among them."""
        number = {int(joint): place for place, joint in enumerate(joints)}
        mirror = np.array([number[int(self.mirror[joint])] for joint in joints], dtype=int)
        whole = [limb for limb in self.limbs if all(int(joint) in number for joint in limb.ravel())]
        limbs = np.array([[number[int(joint)] for joint in limb.ravel()] for limb in whole], dtype=int)
        views = tuple(view.joints(joints) for view in self.views)
        return replace(self, views=views, mirror=mirror, limbs=limbs.reshape(-1, 2, 2))

    def with_views(self, changed: Mapping[int, CameraView]) -> SynchronousViews:
        """Some of the views replaced."""
        return replace(self, views=tuple(changed.get(c, view) for c, view in enumerate(self.views)))

    def cameras(self, cameras: Sequence[int]) -> SynchronousViews:
        """Some of the cameras."""
        return replace(self, views=tuple(self.views[c] for c in cameras))


def limb_joints(skeleton: Skeleton) -> Int[np.ndarray, " joint"]:
    """Where arms and legs are; of a skeleton without them, some joints and those on the other side."""
    named = [f"{side}_{joint}" for joint in _LIMB_JOINTS for side in ("left", "right")]
    found = [skeleton.index(name) for name in named if name in skeleton.joints]
    if len(found) >= 6:
        return np.array(found)
    some = np.linspace(0, skeleton.n_joints - 1, min(skeleton.n_joints, _MOST_JOINTS)).round().astype(int)
    return np.unique(np.concatenate([some, skeleton.mirror[some]]))
