"""OpenCV FileStorage YAML as EasyMocap writes it: ``intri.yml`` and ``extri.yml`` in one folder, metres.

``intri.yml``: names, K_<camera>, dist_<camera> (or D_), H_ and W_. ``extri.yml``: names, Rot_<camera> (matrix) or
R_<camera> (Rodrigues vector), T_<camera>; world to camera.

Read by a YAML library, not by OpenCV, whose reader kills the process on lists that are nested deeply.
"""

from __future__ import annotations

import reprlib
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from fgpose.io.calibration.calibrated_view import CalibratedView, numbers, rotation_matrix
from fgpose.io.content import read_content

# A hundred cameras take 100 kB; the library reads about as much in a second.
_MAX_BYTES = 1_000_000


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
    try:
        text = read_content(path, _MAX_BYTES).decode("utf-8-sig")
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
    K = numbers(name, "K", _matrix(intrinsics, name, "K"), 3, 3)
    sizes = [intrinsics.get(f"{key}_{name}", 2 * K[axis, 2]) for axis, key in enumerate(("W", "H"))]
    width, height = numbers(name, "the image size", [_number(size, name, "the image size") for size in sizes], 2)
    return CalibratedView(
        name=name,
        size_px=(round(width), round(height)),
        K=K,
        R=rotation_matrix(name, _matrix(extrinsics, name, "Rot", "R")),
        t=numbers(name, "T", _matrix(extrinsics, name, "T"), 3),
        distortion=np.ravel(numbers(name, "dist", _matrix(intrinsics, name, "dist", "D"))),
    )
