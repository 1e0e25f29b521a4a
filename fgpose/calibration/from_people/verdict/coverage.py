"""What the walker covered: how much of the room, and how each camera saw it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from fgpose.calibration.from_people.walk import Walk
from fgpose.calibration.from_people.world.anatomy import Anatomy
from fgpose.geometry.camera import CameraRig

_CELL_M = 0.5  # of the floor: half a step; a person fills one
_GRID = 4  # rows and columns into which an image is divided
_HEIGHTS_M = (0.1, 1.0, 1.7)  # feet, hips and head: an image with all three shows a person
_CENTILES = (0.05, 0.95)  # of depths, against single detections that are wrong


@dataclass(frozen=True, eq=False)
class Coverage:
    """What of the room was walked, and how each camera saw the walker. NaN: never seen."""

    common_share: float
    """Of the floor that two cameras see from head to foot, the share on which the person was; NaN where there is
    none."""
    area_m2: float
    """Of the floor on which the person was while two cameras saw them."""
    box_m: Float[np.ndarray, "2 3"]
    """Corners of the box in which the joints were, which two cameras saw; world frame."""
    near_m: Float[np.ndarray, " camera"]
    """Depth of the hips from each camera: 5th centile ..."""
    far_m: Float[np.ndarray, " camera"]
    """... and 95th."""
    image_share: Float[np.ndarray, " camera"]
    """Share of a grid of 4 x 4 of the image in which joints were seen."""
    along_m: Float[np.ndarray, " camera"]
    """Standard deviation of the way over the floor that the camera saw, along its main direction ..."""
    across_m: Float[np.ndarray, " camera"]
    """... and across it: small where the person walked on one line."""
    seen_s: Float[np.ndarray, " camera"]
    """For how long the camera saw the person."""

    @property
    def depth_ratio(self) -> Float[np.ndarray, " camera"]:
        """Far to near."""
        return self.far_m / self.near_m


def coverage(walk: Walk, rig: CameraRig, joints_m: Float[np.ndarray, "frame joint 3"]) -> Coverage:
    """Of a walk in the world.

    Args:
        walk: what the cameras saw.
        rig: in metres, z up, floor z = 0.
        joints_m: of the walk, world frame; NaN = not determined.
    """
    seen, sees = walk.seen, walk.shows_walker
    hips_m, by_two = Anatomy(walk.skeleton).hips_m(joints_m), seen.sum(axis=1) >= 2
    known_m = joints_m[by_two & np.isfinite(joints_m).all(axis=-1)]
    walked_m = hips_m[(sees.sum(axis=1) >= 2) & np.isfinite(hips_m).all(axis=-1), :2]
    cameras = [_of_camera(c, walk, rig, hips_m, seen[:, c], sees[:, c]) for c in range(rig.n_cameras)]
    box_m = np.quantile(known_m, _CENTILES, axis=0) if len(known_m) else np.full((2, 3), np.nan)
    return Coverage(_common_share(walked_m, rig), _area_m2(walked_m), box_m, *np.array(cameras).T)


def _of_camera(
    c: int,
    walk: Walk,
    rig: CameraRig,
    hips_m: Float[np.ndarray, "frame 3"],
    seen: Bool[np.ndarray, "frame joint"],
    sees: Bool[np.ndarray, " frame"],
) -> list[float]:
    """near, far, image_share, along, across, seen_s of a camera."""
    camera = rig.cameras[c]
    used_m = hips_m[sees & np.isfinite(hips_m).all(axis=-1)]
    cells = np.floor(walk.points2d_px[:, c][seen] / np.array(camera.size_px) * _GRID)
    inside = cells[((cells >= 0) & (cells < _GRID)).all(axis=-1)]
    share = len(np.unique(inside, axis=0)) / _GRID**2
    if not len(used_m):
        return [np.nan, np.nan, share, np.nan, np.nan, float(sees.sum()) * walk.step_s]
    near, far = np.quantile(camera.to_camera_frame(used_m)[:, 2], _CENTILES)
    ground_m = used_m[:, :2] - used_m[:, :2].mean(axis=0)
    across, along = np.sqrt(np.maximum(np.linalg.eigvalsh(ground_m.T @ ground_m / len(ground_m)), 0.0))
    return [float(near), float(far), share, float(along), float(across), float(sees.sum()) * walk.step_s]


def _cells(ground_m: Float[np.ndarray, "point 2"]) -> set[tuple[int, int]]:
    cells = np.unique(np.floor(ground_m / _CELL_M).astype(int), axis=0)
    return {(int(x), int(y)) for x, y in cells}


def _area_m2(walked_m: Float[np.ndarray, "point 2"]) -> float:
    return len(_cells(walked_m)) * _CELL_M**2


def _common_share(walked_m: Float[np.ndarray, "point 2"], rig: CameraRig) -> float:
    """Of the floor between the cameras; beyond them nobody is expected to walk."""
    places_m = np.concatenate([np.array([camera.position_m[:2] for camera in rig.cameras]), walked_m])
    low, high = np.floor(places_m.min(axis=0) / _CELL_M), np.floor(places_m.max(axis=0) / _CELL_M)
    grid = np.stack(np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(low, high, strict=True)), indexing="ij"), -1)
    centres_m = (grid.reshape(-1, 2) + 0.5) * _CELL_M
    common = {(int(x), int(y)) for x, y in grid.reshape(-1, 2)[_seen_by_two(centres_m, rig)]}
    return len(common & _cells(walked_m)) / len(common) if common else float("nan")


def _seen_by_two(ground_m: Float[np.ndarray, "point 2"], rig: CameraRig) -> Bool[np.ndarray, " point"]:
    """Whether two cameras show a person there, from head to foot."""
    heights_m = np.broadcast_to(np.array(_HEIGHTS_M)[:, None], (len(_HEIGHTS_M), len(ground_m)))
    people_m = np.concatenate([np.broadcast_to(ground_m, (*heights_m.shape, 2)), heights_m[..., None]], axis=-1)
    inside = []
    for camera in rig.cameras:
        px = camera.project(people_m)
        inside.append(((px >= 0) & (px < np.array(camera.size_px))).all(axis=(0, 2)))
    return np.asarray(np.sum(inside, axis=0) >= 2)
