"""TOML calibrations of Pose2Sim, aniposelib and caliscope: one table per camera.

All have ``matrix``, ``distortions``, ``rotation`` (Rodrigues vector, in some versions of caliscope a matrix) and
``translation``, world to camera. They differ in what is around it:

- Pose2Sim: any table names, ``fisheye`` in every table, metres, cameras in the order of the file.
- aniposelib: ``[cam_0]``, ``[cam_1]``, ..., the unit of the calibration board (often mm), cameras in natural order.
- fgpose: writes any of these, with ``time_offset_s`` in the table of a camera whose clock is off; others read by name
  and take no notice of it. The same with ``start_s``, the part of it that tells when a recording began, and with what
  changes in time: ``clock_drift``, ``clock_jumps`` (pairs: since when, how much later) and ``moves`` (tables with
  since_s, rotation and translation).
- fgpose: in the table ``[metadata.fgpose]`` of Pose2Sim's and aniposelib's files, which these do not read, how the
  cameras became what they are, where that is known.
- caliscope: tables ``[cameras.0]``, or ``[cam_0]`` with a ``port``; metres; a camera that is ``ignore``d or has no pose
  is left out. It detects in images turned by ``rotation_count`` quarter turns and turns the points back: the
  calibration is that of the images as recorded.
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np

from fgpose.config import parse_toml
from fgpose.geometry.camera import Camera, CameraRig
from fgpose.geometry.rigid import inverse, pose_of
from fgpose.io.atomic import write_text
from fgpose.io.calibration.calibrated_view import CalibratedView, UnitOfFormat, numbers, rotation_matrix
from fgpose.io.calibration.calibration_origin import CalibrationOrigin, origin_of_table, table_of
from fgpose.io.names import natural_key

_NO_CAMERAS = ("metadata", "capture_volume", "charuco", "checkerboard")
_AT_THE_ORIGIN = {"rotation": [0.0] * 3, "translation": [0.0] * 3}
_METADATA = {"adjusted": False, "error": 0.0}
_OWN = "fgpose"
"""Table of the metadata that is ours."""
_NULL = "null"
_CLOCK = ("time_offset_s", "start_s", "clock_drift")
_KEYS = ("matrix", "distortions", "rotation", "translation", "size")


def read(text: str, *, poses: bool = True) -> tuple[list[CalibratedView], UnitOfFormat]:
    """Cameras of a TOML calibration and the unit its format prescribes.

    Args:
        text: of the file.
        poses: whether every camera needs a pose; otherwise one without is at the origin, as caliscope and Pose2Sim
            leave it that way until the extrinsics are calibrated.

    Raises:
        ValueError: the text is not TOML, has no cameras, or a camera is incomplete; the message names it.
    """
    try:
        document = parse_toml(text)
    except ValueError as error:
        raise ValueError(f"not a calibration, or a truncated one: {error}") from None
    tables = _camera_tables(document)
    if not tables:
        raise ValueError("no camera in it: a calibration has one table per camera with matrix, rotation, translation")
    is_pose2sim = all(isinstance(table.get("fisheye"), bool) for table in tables.values())
    is_caliscope = _has_calibration(document.get("cameras")) or all("port" in table for table in tables.values())
    names = list(tables) if is_pose2sim else sorted(tables, key=natural_key)
    absent = {} if poses else _AT_THE_ORIGIN
    used = [name for name in names if not tables[name].get("ignore", False)]
    if is_caliscope and poses:
        used = _with_pose(used, tables)
    views = [_view(name, absent | _without_null(tables[name])) for name in used]
    return views, "m" if is_pose2sim or is_caliscope else "auto"


def _without_null(table: dict[str, Any]) -> dict[str, Any]:
    """caliscope has written None as the text "null"."""
    return {key: value for key, value in table.items() if value != _NULL}


def _with_pose(names: list[str], tables: dict[str, dict[str, Any]]) -> list[str]:
    """Those that caliscope has placed; it leaves the others without a pose."""
    lost = [name for name in names if not {"rotation", "translation"} <= _without_null(tables[name]).keys()]
    if lost == names:
        raise ValueError("no camera has a pose: calibrate the extrinsics in caliscope")
    if lost:
        warnings.warn(
            f"camera {', '.join(lost)} has no pose: caliscope has not placed it, and it is left out of the calibration",
            stacklevel=5,
        )
    return [name for name in names if name not in lost]


def quarter_turns(text: str) -> dict[str, int]:
    """By how many quarter turns, clockwise, caliscope turns the images of each camera before it detects anything; those
    that it turns only. Raises ValueError if the text is not TOML."""
    if "rotation_count" not in text:
        return {}
    tables = _camera_tables(parse_toml(text))
    turns = {str(table.get("name", key)): table.get("rotation_count", 0) for key, table in tables.items()}
    return {name: turn for name, turn in turns.items() if isinstance(turn, int) and turn % 4}


def read_origin(text: str) -> CalibrationOrigin:
    """How the cameras of a TOML calibration became what they are; empty where it does not say, or where its cameras
    were changed since. Raises ValueError if that is damaged; the caller names the file."""
    if f"[metadata.{_OWN}]" not in text:
        # As in every file of another program, of which some are long.
        return CalibrationOrigin()
    try:
        document = parse_toml(text)
    except ValueError as error:
        raise ValueError(f"not a calibration, or a truncated one: {error}") from None
    metadata = document.get("metadata")
    own = metadata.get(_OWN) if isinstance(metadata, dict) else None
    return CalibrationOrigin() if own is None else origin_of_table(own, _camera_tables(document))


def has_cameras(document: dict[str, Any]) -> bool:
    """Whether the tables of a TOML document are cameras of one of these formats."""
    return bool(_camera_tables(document))


def _has_calibration(cameras: Any) -> TypeGuard[dict[str, dict[str, Any]]]:
    """Whether these are caliscope's cameras, and not only tables that say where a camera's images come from."""
    if not isinstance(cameras, dict):
        return False
    return any(isinstance(table, dict) and any(key in table for key in _KEYS[:4]) for table in cameras.values())


def _camera_tables(document: dict[str, Any]) -> dict[str, dict[str, Any]]:
    nested = document.get("cameras")
    if _has_calibration(nested):
        document = {f"cam_{key}" if key.isdigit() else key: table for key, table in nested.items()}
    return {
        name: table
        for name, table in document.items()
        if isinstance(table, dict) and name not in _NO_CAMERAS and any(key in table for key in _KEYS[:4])
    }


def _view(key: str, table: dict[str, Any]) -> CalibratedView:
    name = str(table.get("name", key))
    missing = [what for what in _KEYS if what not in table]
    if missing == ["rotation", "translation"]:
        raise ValueError(
            f"camera {name} has no rotation and translation. If these are lenses only, fgpose calibrate with "
            "--intrinsics finds where the cameras are"
        )
    if missing:
        raise ValueError(f"camera {name}: {', '.join(missing)} is missing")
    width, height = numbers(name, "size", table["size"], 2)
    clock: dict[str, Any] = {key: float(numbers(name, key, table.get(key, 0.0), 1)[0]) for key in _CLOCK}
    return CalibratedView(
        name=name,
        size_px=(round(width), round(height)),
        K=numbers(name, "matrix", table["matrix"], 3, 3),
        R=rotation_matrix(name, table["rotation"]),
        t=numbers(name, "translation", table["translation"], 3),
        distortion=numbers(name, "distortions", table["distortions"]).ravel(),
        lens="fisheye" if table.get("fisheye", False) else "pinhole",
        **clock,
        clock_jumps=_jumps(name, table.get("clock_jumps", [])),
        moves=_moves(name, table.get("moves", [])),
    )


def _jumps(name: str, jumps: Any) -> tuple[tuple[float, float], ...]:
    array = numbers(name, "clock_jumps", jumps)
    if array.size == 0:
        return ()
    if array.ndim != 2 or array.shape[1] != 2:
        raise ValueError(f"camera {name}: clock_jumps must be pairs of seconds: [[since, how much later], ...]")
    return tuple((float(since_s), float(by_s)) for since_s, by_s in array)


def _moves(name: str, moves: Any) -> tuple[tuple[float, np.ndarray], ...]:
    if not isinstance(moves, list) or not all(isinstance(each, dict) for each in moves):
        raise ValueError(f"camera {name}: moves must be a list of tables with since_s, rotation and translation")
    found = []
    for each in moves:
        missing = [key for key in ("since_s", "rotation", "translation") if key not in each]
        if missing:
            raise ValueError(f"camera {name}: a move lacks {', '.join(missing)}")
        since_s = float(numbers(name, "since_s", each["since_s"], 1)[0])
        translation = numbers(name, "translation", each["translation"], 3)
        found.append((since_s, inverse(pose_of(rotation_matrix(name, each["rotation"]), translation))))
    if [since_s for since_s, _ in found] != sorted({since_s for since_s, _ in found}):
        raise ValueError(f"camera {name}: moves must be in the order of time")
    return tuple(found)


def write_pose2sim(rig: CameraRig, path: Path, origin: CalibrationOrigin | None = None) -> None:
    """Write a rig as Pose2Sim TOML, see pose2sim_text."""
    write_text(path, pose2sim_text(rig, origin))


def pose2sim_text(rig: CameraRig, origin: CalibrationOrigin | None = None) -> str:
    """A rig as Pose2Sim TOML, metres. No distortion is written as four zeros, which Pose2Sim expects; a time offset
    only where there is one, so that the file of synchronous cameras is exactly Pose2Sim's."""
    import tomli_w

    tables = {}
    for camera in rig.cameras:
        own = {"size": [float(side) for side in camera.size_px], "fisheye": camera.lens == "fisheye"}
        tables[camera.name] = _table(camera, 4) | own
    return tomli_w.dumps(tables | _metadata(tables, origin))


def write_lenses(rig: CameraRig, path: Path, origin: CalibrationOrigin | None = None) -> None:
    """Write the lenses of cameras alone, as Pose2Sim TOML without poses: load_intrinsics reads it, load_rig refuses
    it."""
    tables = {}
    for camera in rig.cameras:
        table = _table(camera, 4) | {"fisheye": camera.lens == "fisheye"}
        tables[camera.name] = {key: value for key, value in table.items() if key not in ("rotation", "translation")}
    _write(path, tables | _metadata(tables, origin))


def _metadata(tables: dict[str, Any], origin: CalibrationOrigin | None) -> dict[str, Any]:
    own = table_of(origin, tables)
    return {"metadata": _METADATA | ({_OWN: own} if own else {})}


def write_aniposelib(rig: CameraRig, path: Path, origin: CalibrationOrigin | None = None) -> None:
    """Write a rig as aniposelib's TOML, metres.

    aniposelib reads the tables in the order of their texts, where cam_10 comes before cam_2: their numbers have as
    many digits as the last one needs. Pose2Sim and caliscope's export write and read the same.
    """
    digits = len(str(rig.n_cameras - 1))
    tables = {f"cam_{c:0{digits}}": _table(camera, 5) | _if_fisheye(camera) for c, camera in enumerate(rig.cameras)}
    _write(path, tables | _metadata(tables, origin))


def write_caliscope(rig: CameraRig, path: Path) -> None:
    """Write a rig as caliscope's camera_array.toml, metres: cameras by whole numbers, their names beside them."""
    cameras = {}
    for c, camera in enumerate(rig.cameras):
        own = {"cam_id": c, "rotation_count": 0, "ignore": False, "fisheye": camera.lens == "fisheye"}
        cameras[str(c)] = _table(camera, 5) | own
    _write(path, {"cameras": cameras})


def _write(path: Path, document: dict[str, Any]) -> None:
    import tomli_w

    write_text(path, tomli_w.dumps(document))


def _table(camera: Camera, n_coefficients: int) -> dict[str, Any]:
    """What all formats have; a pinhole lens with fewer coefficients of distortion than usual gets zeros."""
    n_zeros = n_coefficients - camera.distortion.size if camera.lens == "pinhole" else 0
    return {
        "name": camera.name,
        "size": list(camera.size_px),
        "matrix": camera.K.tolist(),
        "distortions": [*camera.distortion.tolist(), *[0.0] * n_zeros],
        **_pose(camera),
        **_in_time(camera),
    }


def _pose(camera: Camera) -> dict[str, Any]:
    from scipy.spatial.transform import Rotation

    camera_T_world = camera.camera_T_world
    return {
        "rotation": Rotation.from_matrix(camera_T_world[:3, :3]).as_rotvec().tolist(),
        "translation": camera_T_world[:3, 3].tolist(),
    }


def _in_time(camera: Camera) -> dict[str, Any]:
    """What of it depends on time, where something does."""
    moved = [replace(camera, world_T_camera=pose, moves=()) for _, pose in camera.moves]
    table = {
        **{key: getattr(camera, key) for key in _CLOCK},
        "clock_jumps": [list(jump) for jump in camera.clock_jumps],
        "moves": [{"since_s": since_s} | _pose(at) for (since_s, _), at in zip(camera.moves, moved, strict=True)],
    }
    return {key: value for key, value in table.items() if value}


def _if_fisheye(camera: Camera) -> dict[str, bool]:
    """A table that says fisheye whatever the lens is would be Pose2Sim's."""
    return {"fisheye": True} if camera.lens == "fisheye" else {}
