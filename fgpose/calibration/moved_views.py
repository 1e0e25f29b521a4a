"""Per-view 3D goes with the camera that saw it."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from fgpose.people_observations import PeopleObservations

Recording = TypeVar("Recording", Observations, PeopleObservations)


def moved_with_cameras(observations: Recording, before: CameraRig, after: CameraRig) -> Recording:
    """The views' own 3D joints, of one person or of everybody, moved with their cameras."""
    if isinstance(observations, PeopleObservations):
        return _everybody_moved(observations, before, after)  # pyrefly: ignore[bad-return]
    points3d_m, covariance_m2 = observations.points3d_m, observations.covariance3d_m2
    if points3d_m is None:
        return observations
    moves = _moves(before, after)
    R, t_m = moves[:, None, :3, :3], moves[:, None, :3, 3]
    return replace(
        observations,
        points3d_m=(R @ points3d_m[..., None])[..., 0] + t_m,
        covariance3d_m2=None if covariance_m2 is None else R @ covariance_m2 @ R.swapaxes(-1, -2),
    )


def _everybody_moved(people: PeopleObservations, before: CameraRig, after: CameraRig) -> PeopleObservations:
    moves = dict(zip(before.names, _moves(before, after), strict=True))
    images = []
    for image in people.images:
        points3d_m, covariance_m2 = image.points3d_m, image.covariance3d_m2
        R, t_m = moves[image.camera][:3, :3], moves[image.camera][:3, 3]
        moved = image if points3d_m is None else replace(image, points3d_m=points3d_m @ R.T + t_m)
        images.append(moved if covariance_m2 is None else replace(moved, covariance3d_m2=R @ covariance_m2 @ R.T))
    return replace(people, images=tuple(images))


def _moves(before: CameraRig, after: CameraRig) -> np.ndarray:
    """(C, 4, 4) of each camera, in the world frame."""
    pairs = zip(before.cameras, after.cameras, strict=True)
    return np.stack([new.world_T_camera @ old.camera_T_world for old, new in pairs])
