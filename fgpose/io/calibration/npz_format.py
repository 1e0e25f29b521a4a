"""Our own calibration file: npz with one row per camera, exact and without pickles."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fgpose.geometry.camera import CameraRig
from fgpose.geometry.rigid import inverse
from fgpose.io.arrays import checked, read_arrays, text, texts, write_arrays
from fgpose.io.calibration.calibrated_view import CalibratedView, numbers
from fgpose.io.calibration.calibration_origin import CalibrationOrigin, origin_of_table, table_of
from fgpose.io.content import parse_json
from fgpose.io.tables import Column

# The longest distortion that Camera takes; shorter ones are filled up with NaN.
_MAX_COEFFICIENTS = 8
_TEXTS = ("camera_names", "lens")
_NUMBERS = {
    "size_px": (2,),
    "K": (3, 3),
    "world_T_camera": (4, 4),
    "distortion": (_MAX_COEFFICIENTS,),
    "time_offset_s": (),
    "start_s": (),
}
_ADDED = ("time_offset_s", "start_s")
"""Arrays that older files lack; zero there."""
_CHANGES = {"clock_drift": 1, "clock_jumps": 2, "moves": 17}
"""What changes in time, where something does: rows of the number of the camera and so many numbers. Since when and how
much later; since when and the pose."""
_ORIGIN = "origin"
"""A text of JSON, where something is known."""
ARRAYS = (
    Column("camera_names", "", "their names", "(C,)"),
    Column("size_px", "px", "width and height of the images", "(C, 2)"),
    Column("K", "px", "focal lengths and principal point of each camera", "(C, 3, 3)"),
    Column(
        "world_T_camera",
        "m",
        "pose: takes points of the camera (x right, y down, z forward) to the world",
        "(C, 4, 4)",
    ),
    Column("distortion", "", "coefficients in the order of OpenCV; NaN: not used", "(C, 8)"),
    Column("lens", "", "`pinhole` or `fisheye`", "(C,)"),
    Column("time_offset_s", "s", "how much later than its time stamps say the camera takes its images", "(C,)"),
    Column("start_s", "s", "the part of it that is not of the camera but of a recording: when that began", "(C,)"),
    Column(
        "clock_drift",
        "s/s",
        "number of a camera whose clock drifts, and how much later still for each second of the time stamps",
        "(rows, 2)",
    ),
    Column(
        "clock_jumps",
        "s",
        "number of a camera whose clock jumps, since when by the time stamps, how much later than before",
        "(rows, 3)",
    ),
    Column(
        "moves",
        "s, m",
        "number of a camera that was moved, since when by the time stamps, its pose since then (world_T_camera, "
        "row by row)",
        "(rows, 18)",
    ),
    Column("origin", "", "how the cameras became what they are, as JSON", "text"),
)


def read(path: Path) -> list[CalibratedView]:
    """Cameras of an npz written by write, in metres. Raises ValueError for anything else."""
    return views(read_arrays(path))


def views(file: Mapping[str, np.ndarray]) -> list[CalibratedView]:
    """Cameras from the arrays that rig_arrays gives. Raises ValueError if they are others."""
    missing = [name for name in (*_TEXTS, *_NUMBERS) if name not in file and name not in _ADDED]
    if missing:
        raise ValueError(f"not a calibration of fgpose: the array {', '.join(missing)} is missing")
    names, lenses = (texts(file, name) for name in _TEXTS)
    if len(lenses) != len(names):
        raise ValueError(f"{len(names)} cameras have {len(lenses)} lenses")
    file = {name: np.zeros(len(names)) for name in _ADDED} | dict(file)
    arrays = [checked(file, name, "numbers", len(names), *shape).astype(float) for name, shape in _NUMBERS.items()]
    found = [_view(*row) for row in zip(names, lenses, *arrays, strict=True)]
    return [replace(view, **changes) for view, changes in zip(found, _changes(file, len(names)), strict=True)]


def _changes(file: Mapping[str, np.ndarray], n_cameras: int) -> list[dict[str, Any]]:
    """What changes in time of each camera."""
    rows = {name: np.zeros((0, 1 + size)) for name, size in _CHANGES.items()}
    for name, empty in rows.items():
        if name in file:
            array = np.asarray(file[name])
            if array.ndim != 2 or array.shape[1] != empty.shape[1] or not np.isfinite(array.astype(float)).all():
                raise ValueError(f"the array {name} must have rows of {empty.shape[1]} finite numbers")
            if not np.isin(array[:, 0], np.arange(n_cameras)).all():
                raise ValueError(f"the array {name} is of a camera that there is not")
            rows[name] = array.astype(float)
    found = []
    for c in range(n_cameras):
        drift, jumps, moves = (rows[name][rows[name][:, 0] == c, 1:] for name in _CHANGES)
        found.append(
            {
                "clock_drift": float(drift.sum()),
                "clock_jumps": tuple((float(since_s), float(by_s)) for since_s, by_s in jumps),
                "moves": tuple((float(row[0]), row[1:].reshape(4, 4)) for row in moves),
            }
        )
    return found


def _view(
    name: str,
    lens: str,
    size_px: np.ndarray,
    K: np.ndarray,
    world_T_camera: np.ndarray,
    distortion: np.ndarray,
    time_offset_s: float,
    start_s: float,
) -> CalibratedView:
    if lens not in ("pinhole", "fisheye"):
        raise ValueError(f"camera {name}: lens must be pinhole or fisheye, got {lens}")
    width, height = numbers(name, "size_px", size_px, 2)
    camera_T_world = inverse(world_T_camera)
    return CalibratedView(
        name=name,
        size_px=(round(width), round(height)),
        K=K,
        R=camera_T_world[:3, :3],
        t=camera_T_world[:3, 3],
        distortion=distortion[~np.isnan(distortion)],
        lens="fisheye" if lens == "fisheye" else "pinhole",
        time_offset_s=float(time_offset_s),
        start_s=float(start_s),
        world_T_camera=world_T_camera,
    )


def read_origin(path: Path) -> CalibrationOrigin:
    """How the cameras became what they are; empty where the file does not say. Raises ValueError if it is damaged."""
    file = read_arrays(path, (_ORIGIN,))
    if _ORIGIN not in file:
        return CalibrationOrigin()
    try:
        table = parse_json(text(file, _ORIGIN))
    except ValueError:
        table = None
    return origin_of_table(table)


def write(rig: CameraRig, path: Path, origin: CalibrationOrigin | None = None) -> None:
    """Write a rig as read and read_origin read it."""
    own = table_of(origin)
    write_arrays(path, rig_arrays(rig) | ({_ORIGIN: np.array(json.dumps(own, allow_nan=False))} if own else {}))


def rig_arrays(rig: CameraRig) -> dict[str, np.ndarray]:
    """All that is known of the cameras; unused distortion coefficients are NaN."""
    distortion = np.full((rig.n_cameras, _MAX_COEFFICIENTS), np.nan)
    for row, camera in zip(distortion, rig.cameras, strict=True):
        row[: camera.distortion.size] = camera.distortion
    return {
        "camera_names": np.array(rig.names),
        "size_px": np.array([camera.size_px for camera in rig.cameras]),
        "K": rig.K,
        "world_T_camera": np.stack([camera.world_T_camera for camera in rig.cameras]),
        "distortion": distortion,
        "lens": np.array([camera.lens for camera in rig.cameras]),
        "time_offset_s": rig.time_offsets_s,
        "start_s": np.array([camera.start_s for camera in rig.cameras]),
    } | _change_arrays(rig)


def _change_arrays(rig: CameraRig) -> dict[str, np.ndarray]:
    rows: dict[str, list[list[float]]] = {name: [] for name in _CHANGES}
    for c, camera in enumerate(rig.cameras):
        if camera.clock_drift:
            rows["clock_drift"].append([c, camera.clock_drift])
        rows["clock_jumps"] += [[c, since_s, by_s] for since_s, by_s in camera.clock_jumps]
        rows["moves"] += [[c, since_s, *np.ravel(pose).tolist()] for since_s, pose in camera.moves]
    return {name: np.array(each) for name, each in rows.items() if each}
