"""Where each camera saw the joints of people, as rays on an even grid of time, with the changes so far undone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from fgpose.calibration.changes.change import Change, later_s, pieces
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from fgpose.sampling import Around, parts_of, spread_evenly, usual_step_s

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
    weight: Float[np.ndarray, "camera time joint"]
    """Confidence; zero where not seen."""
    pose: Int[np.ndarray, "camera time"]
    """Which of the poses each camera had."""
    world_T_camera: Float[np.ndarray, "pose 4 4"]
    """The last one is NaN: of cameras without an image."""

    @property
    def n_cameras(self) -> int:
        return len(self.direction)

    @property
    def centre_m(self) -> Float[np.ndarray, "camera time 3"]:
        """Where each camera was."""
        return self.world_T_camera[:, :3, 3][self.pose]

    @property
    def world_R_camera(self) -> Float[np.ndarray, "camera time 3 3"]:
        """How each camera was turned."""
        return self.world_T_camera[:, :3, :3][self.pose]

    def between(self, first: int, end: int) -> Rays:
        """Some of the grid."""
        part = slice(first, end)
        return Rays(
            self.time_s[part],
            self.step_s,
            self.direction[:, part],
            self.weight[:, part],
            self.pose[:, part],
            self.world_T_camera,
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
    first, *others = (_of_person(own, rig, changes, step_s, n_gap) for own in people)
    if not others:
        return first  # without a copy: an hour of four cameras takes 0.15 GB
    every = [first, *others]
    time_s = np.concatenate([each.time_s for each in every])
    direction, weight, pose = (
        np.concatenate([getattr(each, name) for each in every], axis=1) for name in ("direction", "weight", "pose")
    )
    return Rays(time_s, step_s, direction, weight, pose, first.world_T_camera)


def _of_person(own: Observations, rig: CameraRig, changes: Sequence[Change], step_s: float, n_gap: int) -> Rays:
    joints = chosen_joints(own)
    begin_s, end_s = own.frame_time_s[[0, -1]]
    time_s = begin_s + step_s * np.arange(int((end_s - begin_s) / step_s + 1e-6) + 1)
    of_cameras = rig.n_cameras, len(time_s) + n_gap
    direction = np.full((*of_cameras, len(joints), 3), np.nan, dtype=np.float32)
    weight = np.zeros((*of_cameras, len(joints)), dtype=np.float32)
    held = [pieces(changes, c, camera) for c, camera in enumerate(rig.cameras)]
    world_T_camera = np.array([*(each for of_camera in held for *_, each in of_camera), np.full((4, 4), np.nan)])
    first = np.cumsum([0, *map(len, held)])
    pose = np.full(of_cameras, first[-1])
    for c, camera in enumerate(rig.cameras):
        stamp_s = own.frame_time_s if own.time_s.ndim == 1 else own.time_s[:, c]
        there = np.isfinite(stamp_s)
        stamp_s = stamp_s[there]
        taken_s = stamp_s + camera.time_offset_s + later_s(changes, c, stamp_s)
        images = np.flatnonzero(there)
        for part in parts_of(len(time_s)):
            at_s = time_s[part]
            at_px, at_weight = np.full((len(at_s), len(joints), 2), np.nan), np.zeros((len(at_s), len(joints)))
            if len(images) > 1:
                around = Around.of(taken_s, at_s)
                begin = int(around.before.min())
                near, around = images[begin : around.before.max() + 2], around.counted_from(begin)
                at_px = around.between(camera.undistort(own.points2d_px[near, c][:, joints]))
                at_weight = around.smaller(own.confidence[near, c][:, joints])
            image = np.searchsorted(taken_s, at_s + 1e-9, side="right") - 1
            stamps_s = stamp_s[np.maximum(image, 0)] if there.any() else at_s
            for number, (since_s, until_s, turned) in enumerate(held[c], start=first[c]):
                holds = part.start + np.flatnonzero((stamps_s >= since_s) & (stamps_s < until_s))
                normalized = (at_px[holds - part.start] - camera.K[:2, 2]) / np.diag(camera.K)[:2]
                ray = np.concatenate([normalized, np.ones((*normalized.shape[:-1], 1))], axis=-1) @ turned[:3, :3].T
                direction[c, holds] = ray / np.linalg.norm(ray, axis=-1, keepdims=True)
                pose[c, holds] = number
            weight[c, part] = np.where(np.isfinite(direction[c, part]).all(axis=-1), at_weight, 0.0)
    return Rays(np.append(time_s, np.full(n_gap, np.nan)), step_s, direction, weight, pose, world_T_camera)


def chosen_joints(own: Observations) -> Int[np.ndarray, " joint"]:
    """Those of arms and legs, which move most; of a skeleton without them some of all."""
    bones = [bone for pair in own.skeleton.limb_pairs for bone in pair]
    joints = np.array(sorted({joint for bone in bones for joint in bone}) or range(own.skeleton.n_joints))
    return joints[spread_evenly(len(joints), _MAX_JOINTS)]
