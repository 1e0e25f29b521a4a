"""A body over time: in space, in the images, and how its joints were found."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import rerun as rr
from jaxtyping import Float

from fgpose.geometry.camera import CameraRig
from fgpose.trajectory import Status, Trajectory
from fgpose.viewer import paths
from fgpose.viewer.palette import Colour, faded
from fgpose.viewer.rows import Rows, bone_rows, ellipsoid_rows, point_rows, status_rows

# Thick enough to be seen from the distance of the cameras, thinner than a wrist.
_JOINT_RADIUS_M = 0.017
_BONE_RADIUS_M = 0.007
# A predicted joint is half as thick as an observed one, and paler.
_PREDICTED_SCALE = 0.5


def body_rows(
    name: str,
    trajectory: Trajectory,
    rig: CameraRig,
    colour: Colour,
    thickness: float = 1.0,
    before: np.ndarray | None = None,
) -> Iterator[Rows]:
    """Skeleton, covariance, reprojections and status.

    Args:
        name: of the result or of the person.
        trajectory: one frame or more.
        rig: the cameras.
        colour: of the skeleton.
        thickness: of the skeleton; 1 for a final result.
        before: (J,) status in the frame before the first, if there was one.
    """
    path = paths.trajectory(name)
    yield from _skeleton_rows(path, trajectory, colour, thickness)
    if trajectory.covariance_m2 is not None:
        yield ellipsoid_rows(f"{path}/covariance", trajectory.positions_m, trajectory.covariance_m2)
    reprojections_px = rig.project(trajectory.positions_m)
    for c, camera in enumerate(rig.names):
        yield point_rows(paths.reprojections(camera, name), rr.Points2D, reprojections_px[:, c])
    first = np.full(trajectory.skeleton.n_joints, Status.OBSERVED) if before is None else before
    for j in np.flatnonzero((np.diff(trajectory.status, axis=0, prepend=first[None]) != 0).any(axis=0)):
        path = paths.join(paths.STATUS, name, trajectory.skeleton.joints[j])
        yield status_rows(path, trajectory.status[:, j], int(first[j]))


def _skeleton_rows(path: str, trajectory: Trajectory, colour: Colour, thickness: float) -> Iterator[Rows]:
    skeleton, observed = trajectory.skeleton, trajectory.observed
    bones = (*skeleton.bones, *skeleton.lines)
    bone_observed = observed[:, np.array(bones, dtype=int).reshape(-1, 2)].all(axis=-1)
    pair = np.array([faded(colour), colour], dtype=np.uint8)
    scale = thickness * np.array([_PREDICTED_SCALE, 1.0])
    joint, bone = observed.astype(int), bone_observed.astype(int)
    radii = _JOINT_RADIUS_M * scale[joint]
    yield point_rows(f"{path}/joints", rr.Points3D, trajectory.positions_m, pair[joint], radii)
    yield bone_rows(f"{path}/bones", trajectory.positions_m, bones, pair[bone], _BONE_RADIUS_M * scale[bone])


def median_of_known(values: Float[np.ndarray, "frame joint"]) -> Float[np.ndarray, " frame"]:
    """Median over the joints; NaN where none is known. Ten times as fast as np.nanmedian on a live frame."""
    ordered = np.sort(values, axis=-1)
    count = np.isfinite(values).sum(axis=-1)
    middle = np.stack([(count - 1) // 2, count // 2], axis=-1).clip(min=0)
    return np.take_along_axis(ordered, middle, axis=-1).mean(axis=-1)
