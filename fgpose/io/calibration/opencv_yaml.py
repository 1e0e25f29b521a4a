"""OpenCV FileStorage YAML as EasyMocap writes it: ``intri.yml`` and ``extri.yml`` in one folder, metres.

``intri.yml``: names, K_<camera>, dist_<camera> (or D_), H_ and W_. ``extri.yml``: names, Rot_<camera> (matrix) or
R_<camera> (Rodrigues vector), T_<camera>; world to camera.

Read by a YAML library, not by OpenCV, whose reader kills the process on lists that are nested deeply.
"""

from __future__ import annotations

import re
import reprlib
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from fgpose.geometry.camera import CameraRig
from fgpose.io.atomic import write_text
from fgpose.io.calibration.calibrated_view import CalibratedView, Intrinsics, numbers, rotation_matrix
from fgpose.io.content import read_content

# A hundred cameras take 100 kB and 4,000 values, the corners of a board in a hundred images 300 kB and 20,000.
_MAX_BYTES, _MAX_VALUES = 1_000_000, 80_000
_SEPARATORS = ",:\n[{"  # the library takes 20 us for each
_KEY = re.compile(r"[A-Za-z0-9_-]+")
"""What OpenCV takes in the key of a node, after K_ or T_."""


def read(folder: Path) -> list[CalibratedView]:
    """Cameras of the two files, in the order of ``names`` in intri.yml.

    Without H_ and W_ the image is taken to reach as far beyond the principal point as before it.

    Raises:
        ValueError: a file is missing or damaged, or lacks a camera or one of its matrices; the message names it.
    """
    intrinsics, extrinsics = (_document(folder, name) for name in ("intri.yml", "extri.yml"))
    names = _names(intrinsics)
    if not names:
        raise ValueError("intri.yml has no camera: the list names is missing or empty")
    only_one = set(names) ^ set(_names(extrinsics) or names)
    if only_one:
        raise ValueError(f"camera {', '.join(sorted(only_one))} is in one of intri.yml and extri.yml only")
    return [_view(name, intrinsics, extrinsics) for name in names]


def check(rig: CameraRig) -> None:
    """Raise ValueError if a rig cannot be written: a fisheye lens, which the format does not know, or a name that is no
    key of OpenCV."""
    for camera in rig.cameras:
        if camera.lens == "fisheye":
            raise ValueError(f"camera {camera.name}: EasyMocap's format has no fisheye lens")
        if not _KEY.fullmatch(camera.name):
            raise ValueError(
                f"camera {camera.name}: in EasyMocap's format a name has letters, digits, hyphens and underscores only"
            )


def write(rig: CameraRig, folder: Path) -> None:
    """Write a rig as EasyMocap reads it, metres: intri.yml and extri.yml; a distortion has at least five numbers.

    Warns:
        UserWarning: a camera has a time offset, which the format cannot keep.

    Raises:
        ValueError: as check.
        OSError: a file cannot be written.
    """
    from scipy.spatial.transform import Rotation

    check(rig)
    moved = [camera.name for camera in rig.cameras if camera.moves]
    if moved:
        raise ValueError(f"camera {moved[0]} was moved while it filmed; EasyMocap's format has one pose of each camera")
    late = [
        f"{camera.name} {camera.time_offset_s:.4f} s"
        for camera in rig.cameras
        if camera.time_offset_s or camera.clock_drift or camera.clock_jumps
    ]
    if late:
        warnings.warn(f"{folder}: EasyMocap's format has no time offsets; left out: {', '.join(late)}", stacklevel=3)
    intrinsics, extrinsics = {}, {}
    for camera in rig.cameras:
        name, camera_T_world = camera.name, camera.camera_T_world
        zeros = np.zeros(max(5 - camera.distortion.size, 0))
        intrinsics |= {f"K_{name}": camera.K, f"dist_{name}": np.append(camera.distortion, zeros)[None]}
        intrinsics |= {f"{key}_{name}": size for key, size in zip("WH", camera.size_px, strict=True)}
        rotation_vector = Rotation.from_matrix(camera_T_world[:3, :3]).as_rotvec()
        extrinsics |= {f"R_{name}": rotation_vector[:, None], f"Rot_{name}": camera_T_world[:3, :3]}
        extrinsics |= {f"T_{name}": camera_T_world[:3, 3:]}
    texts = {file: _text(rig.names, values) for file, values in (("intri", intrinsics), ("extri", extrinsics))}
    for file, text in texts.items():
        write_text(folder / f"{file}.yml", text)


def _text(names: tuple[str, ...], values: dict[str, Any]) -> str:
    """As OpenCV writes it: matrices in double precision, other numbers as they are."""
    import cv2

    storage = cv2.FileStorage("", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY | cv2.FILE_STORAGE_FORMAT_YAML)
    storage.write("names", list(names))
    for key, value in values.items():
        storage.write(key, np.ascontiguousarray(value) if isinstance(value, np.ndarray) else value)
    return storage.releaseAndGetString()


class _Loader(yaml.BaseLoader):
    """Lists, tables and texts, whatever their tags (!!opencv-matrix); OpenCV writes no aliases."""

    def compose_node(self, parent: Any, index: Any) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("it has an alias")
        return super().compose_node(parent, index)


def _document(folder: Path, name: str) -> dict[str, Any]:
    path = folder / name
    if not path.is_file():
        raise ValueError(f"{name} is missing in {folder}; intri.yml and extri.yml belong together")
    return yaml_document(path)


def yaml_document(path: Path) -> dict[str, Any]:
    """The tables of a YAML file, also of OpenCV's kind; all values are texts.

    Raises:
        ValueError: it is damaged, or has no tables; the message gives its name.
        OSError: it cannot be read.
    """
    name = path.name
    try:
        text = read_content(path, _MAX_BYTES).decode("utf-8-sig")
        n_values = sum(map(text.count, _SEPARATORS))
        if n_values > _MAX_VALUES:
            raise ValueError(f"it has some {n_values} values, at most {_MAX_VALUES} are read")
        # OpenCV writes %YAML:1.0, which is no directive of YAML.
        body = text.partition("\n")[2] if text.startswith("%YAML") else text
        document = yaml.load(body, _Loader)
    except (ValueError, yaml.YAMLError, RecursionError) as error:
        raise ValueError(f"{name} is damaged or not OpenCV YAML: {str(error) or type(error).__name__}") from None
    if not isinstance(document, dict):
        raise ValueError(f"{name} is empty or not OpenCV YAML")
    return document


def _names(document: dict[str, Any]) -> list[str]:
    names = document.get("names")
    return [name for name in names if isinstance(name, str)] if isinstance(names, list) else []


def intrinsics(document: dict[str, Any]) -> list[Intrinsics]:
    """The cameras of intri.yml alone. Raises ValueError as read."""
    return [_lens(name, document) for name in _names(document)]


def _matrix(document: dict[str, Any], name: str, *keys: str) -> list[float]:
    """Numbers of the first of the matrices that exists, row by row. Raises ValueError, which names the camera."""
    for key in keys:
        data = document.get(f"{key}_{name}")
        data = data.get("data") if isinstance(data, dict) else data
        if isinstance(data, list):
            return [_number(value, name, key) for value in data]
    raise ValueError(f"camera {name}: {' or '.join(f'{key}_{name}' for key in keys)} is missing or damaged")


def _number(value: Any, name: str, what: str) -> float:
    try:
        # OpenCV writes .Nan and .Inf, which no camera has.
        return float(value)
    except (TypeError, ValueError):
        raise ValueError(f"camera {name}: {what} has something that is not a number: {reprlib.repr(value)}") from None


def _view(name: str, intrinsics: dict[str, Any], extrinsics: dict[str, Any]) -> CalibratedView:
    lens = _lens(name, intrinsics)
    width, height = lens.size_px or (2 * lens.K[0, 2], 2 * lens.K[1, 2])
    return CalibratedView(
        name=name,
        size_px=(round(width), round(height)),
        K=lens.K,
        R=rotation_matrix(name, _matrix(extrinsics, name, "Rot", "R")),
        t=numbers(name, "T", _matrix(extrinsics, name, "T"), 3),
        distortion=lens.distortion,
    )


def _lens(name: str, intrinsics: dict[str, Any]) -> Intrinsics:
    given = [intrinsics[f"{key}_{name}"] for key in ("W", "H") if f"{key}_{name}" in intrinsics]
    size_px = None
    if len(given) == 2:
        sides = numbers(name, "the image size", [_number(side, name, "the image size") for side in given], 2)
        size_px = round(sides[0]), round(sides[1])
    K = numbers(name, "K", _matrix(intrinsics, name, "K"), 3, 3)
    distortion = np.ravel(numbers(name, "dist", _matrix(intrinsics, name, "dist", "D")))
    return Intrinsics(name, K, distortion, size_px)
