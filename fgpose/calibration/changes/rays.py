"""Where each camera saw the joints of people, as rays on an even grid of time, with the changes so far undone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from fgpose.calibration.changes.change import Change, later_s, pieces
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from fgpose.sampling import between_images, smaller_around, spread_evenly, usual_step_s

# Errors of detections are correlated over 0.15 s, and nobody moves a limb to and fro in 0.05: more is no information.
_GRID_HZ = 40.0
_MAX_JOINTS = 10


@dataclass(frozen=True, eq=False)
class Rays:
    """Of all people one after the other, each followed by a gap of nothing as long as lags can be."""

    time_s: Float[np.ndarray, " time"]
    """Of the grid, by the common clock; NaN in the gaps."""
    step_s: float
    direction: Float[np.ndarray, "camera time joint 3"]
    """Unit vectors in the world; NaN: not seen."""
    centre_m: Float[np.ndarray, "camera time 3"]
    """Where each camera was."""
    world_R_camera: Float[np.ndarray, "camera time 3 3"]
    """How each camera was turned."""
    weight: Float[np.ndarray, "camera time joint"]
    """Confidence; zero where not seen."""

    @property
    def n_cameras(self) -> int:
        return len(self.direction)

    def between(self, first: int, end: int) -> Rays:
        """Some of the grid."""
        part = slice(first, end)
        return Rays(
            self.time_s[part],
            self.step_s,
            self.direction[:, part],
            self.centre_m[:, part],
            self.world_R_camera[:, part],
            self.weight[:, part],
        )


def grid_step_s(people: Sequence[Observations]) -> float:
    """The step of the images, or a multiple of it where they follow each other faster than is of use."""
    step_s = min(usual_step_s(own.frame_time_s) for own in people)
    return step_s * max(1, round(1 / (_GRID_HZ * step_s)))


def rays_of(
    people: Sequence[Observations], rig: CameraRig, changes: Sequence[Change], step_s: float, n_gap: int
) -> Rays:
    """See Rays.

    Args:
        people: what the cameras saw of each, by their stamps.
        rig: whose time offsets are undone too.
        changes: that are undone.
        step_s: of the grid.
        n_gap: steps of nothing after each person.
    """
    parts = [_of_person(own, rig, changes, step_s) for own in people]
    gap = np.full(n_gap, np.nan)
    time_s = np.concatenate([piece for time_s, *_ in parts for piece in (time_s, gap)])
    direction, weight, centre_m, world_R_camera = (
        np.concatenate([piece for part in parts for piece in (part[n], _nothing(part[n], n_gap))], axis=1)
        for n in (1, 2, 3, 4)
    )
    return Rays(time_s, step_s, direction, centre_m, world_R_camera, np.nan_to_num(weight))


def _nothing(array: np.ndarray, n_gap: int) -> np.ndarray:
    return np.full((array.shape[0], n_gap, *array.shape[2:]), np.nan, dtype=array.dtype)


def _of_person(
    own: Observations, rig: CameraRig, changes: Sequence[Change], step_s: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    joints = chosen_joints(own)
    begin_s, end_s = own.frame_time_s[[0, -1]]
    time_s = begin_s + step_s * np.arange(int((end_s - begin_s) / step_s + 1e-6) + 1)
    n_cameras, shape = rig.n_cameras, (rig.n_cameras, len(time_s), len(joints))
    direction = np.full((*shape, 3), np.nan, dtype=np.float32)
    weight = np.zeros(shape, dtype=np.float32)
    centre_m, world_R_camera = np.empty((n_cameras, len(time_s), 3)), np.empty((n_cameras, len(time_s), 3, 3))
    for c, camera in enumerate(rig.cameras):
        stamp_s = own.frame_time_s if own.time_s.ndim == 1 else own.time_s[:, c]
        there = np.isfinite(stamp_s)
        taken_s = stamp_s[there] + camera.time_offset_s + later_s(changes, c, stamp_s[there])
        at_px = between_images(taken_s, camera.undistort(own.points2d_px[there, c][:, joints]), time_s)
        at_weight = smaller_around(taken_s, own.confidence[there, c][:, joints], time_s)
        image = np.searchsorted(taken_s, time_s + 1e-9, side="right") - 1
        stamps_s = stamp_s[there][np.maximum(image, 0)] if there.any() else time_s
        for since_s, until_s, pose in pieces(changes, c, camera):
            holds = (stamps_s >= since_s) & (stamps_s < until_s)
            normalized = (at_px[holds] - camera.K[:2, 2]) / np.diag(camera.K)[:2]
            ray = np.concatenate([normalized, np.ones((*normalized.shape[:-1], 1))], axis=-1) @ pose[:3, :3].T
            direction[c, holds] = ray / np.linalg.norm(ray, axis=-1, keepdims=True)
            centre_m[c, holds], world_R_camera[c, holds] = pose[:3, 3], pose[:3, :3]
        weight[c] = np.where(np.isfinite(direction[c]).all(axis=-1), at_weight, 0.0)
    return time_s, direction, weight, centre_m, world_R_camera


def chosen_joints(own: Observations) -> Int[np.ndarray, " joint"]:
    """Those of arms and legs, which move most; of a skeleton without them some of all."""
    bones = [bone for pair in own.skeleton.limb_pairs for bone in pair]
    joints = np.array(sorted({joint for bone in bones for joint in bone}) or range(own.skeleton.n_joints))
    return joints[spread_evenly(len(joints), _MAX_JOINTS)]
