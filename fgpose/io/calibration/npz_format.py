"""Our own calibration file: npz with one row per camera, exact and without pickles."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fgpose.geometry.camera import CameraRig
from fgpose.io.arrays import read_arrays
from fgpose.io.atomic import replacing
from fgpose.io.calibration.calibrated_view import CalibratedView

_MAX_COEFFICIENTS = 8
_ARRAYS = {
    "camera_names": (),
    "size_px": (2,),
    "K": (3, 3),
    "world_T_camera": (4, 4),
    "distortion": (_MAX_COEFFICIENTS,),
    "lens": (),
    "time_offset_s": (),
}
_ADDED = ("time_offset_s",)
"""Arrays that older files lack; zero there."""


def read(path: Path) -> list[CalibratedView]:
    """Cameras of an npz written by write, in metres. Raises ValueError for anything else."""
    file = read_arrays(path)
    missing = [name for name in _ARRAYS if name not in file and name not in _ADDED]
    if missing:
        raise ValueError(f"not a calibration of fgpose: the array {', '.join(missing)} is missing")
    n_cameras = file["camera_names"].size
    arrays = {name: file.get(name, np.zeros(n_cameras)) for name in _ARRAYS}
    for name, array in arrays.items():
        if array.shape != (n_cameras, *_ARRAYS[name]):
            raise ValueError(f"array {name} must be {(n_cameras, *_ARRAYS[name])}, got {array.shape}")
    return [_view(*row) for row in zip(*arrays.values(), strict=True)]


def _view(
    name: np.str_,
    size_px: np.ndarray,
    K: np.ndarray,
    world_T_camera: np.ndarray,
    distortion: np.ndarray,
    lens: str,
    time_offset_s: np.floating,
) -> CalibratedView:
    if lens not in ("pinhole", "fisheye"):
        raise ValueError(f"camera {name}: lens must be pinhole or fisheye, got {lens}")
    R = world_T_camera[:3, :3].T
    return CalibratedView(
        name=str(name),
        size_px=(int(size_px[0]), int(size_px[1])),
        K=K,
        R=R,
        t=-R @ world_T_camera[:3, 3],
        distortion=distortion[~np.isnan(distortion)],
        lens="fisheye" if lens == "fisheye" else "pinhole",
        time_offset_s=float(time_offset_s),
    )


def write(rig: CameraRig, path: Path) -> None:
    """Write a rig as read reads it; unused distortion coefficients are NaN."""
    distortion = np.full((rig.n_cameras, _MAX_COEFFICIENTS), np.nan)
    for row, camera in zip(distortion, rig.cameras, strict=True):
        row[: camera.distortion.size] = camera.distortion
    with replacing(path) as temporary:
        np.savez_compressed(
            temporary,
            camera_names=np.array(rig.names),
            size_px=np.array([camera.size_px for camera in rig.cameras]),
            K=np.stack([camera.K for camera in rig.cameras]),
            world_T_camera=np.stack([camera.world_T_camera for camera in rig.cameras]),
            distortion=distortion,
            lens=np.array([camera.lens for camera in rig.cameras]),
            time_offset_s=rig.time_offsets_s,
        )
