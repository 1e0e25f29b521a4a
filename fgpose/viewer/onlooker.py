"""The cameras with which trajectories are shown: those that are known, or one that looks on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.trajectory import Trajectory


def with_rig(rig: CameraRig | None, people: dict[int, Trajectory]) -> tuple[CameraRig, dict[int, Trajectory]]:
    """The cameras that the trajectories know, or one that looks at the people where no calibration is given."""
    if rig is None:
        unseen = {n: replace(each, residual_px=None, visibility=None, camera_names=()) for n, each in people.items()}
        return onlooker(np.concatenate([each.positions_m for each in people.values()])), unseen
    names = next(iter(people.values())).camera_names
    return (rig.subset(names) if names and names != rig.names else rig), people


def onlooker(positions_m: Float[np.ndarray, "frame joint 3"]) -> CameraRig:
    """A camera that looks at these joints from the side. The viewer needs one, and no calibration was given."""
    known = positions_m[np.isfinite(positions_m).all(axis=-1)]
    target_m = np.median(known, axis=0) if len(known) else np.zeros(3)
    K = np.array([[1000.0, 0.0, 500.0], [0.0, 1000.0, 500.0], [0.0, 0.0, 1.0]])
    world_T_camera = np.eye(4)
    world_T_camera[:3, :3] = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    world_T_camera[:3, 3] = target_m - [0.0, 4.0, 0.0]
    return CameraRig((Camera("no calibration", (1000, 1000), K, world_T_camera, np.zeros(0)),))
