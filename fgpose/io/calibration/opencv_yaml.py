"""OpenCV FileStorage YAML as EasyMocap writes it: ``intri.yml`` and ``extri.yml`` in one folder, metres.

``intri.yml``: names, K_<camera>, dist_<camera> (or D_), H_ and W_. ``extri.yml``: names, Rot_<camera> (matrix) or
R_<camera> (Rodrigues vector), T_<camera>; world to camera.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fgpose.io.calibration.calibrated_view import CalibratedView, numbers, rotation_matrix

if TYPE_CHECKING:
    import cv2


def read(folder: Path) -> list[CalibratedView]:
    """Cameras of the two files, in the order of ``names`` in intri.yml.

    Without H_ and W_ the image is taken to reach as far beyond the principal point as before it.

    Raises:
        ValueError: a file is missing or damaged, or lacks a camera or one of its matrices; the message names it.
    """
    intrinsics, extrinsics = (_open(folder, name) for name in ("intri.yml", "extri.yml"))
    names = _names(intrinsics)
    if not names:
        raise ValueError("intri.yml has no camera: the list names is missing or empty")
    only_one = set(names) ^ set(_names(extrinsics) or names)
    if only_one:
        raise ValueError(f"camera {', '.join(sorted(only_one))} is in one of intri.yml and extri.yml only")
    return [_view(name, intrinsics, extrinsics) for name in names]


def _open(folder: Path, name: str) -> cv2.FileStorage:
    import cv2

    path = folder / name
    if not path.is_file():
        raise ValueError(f"{name} is missing in {folder}; intri.yml and extri.yml belong together")
    try:
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    # OpenCV's binding reports a damaged file as a SystemError.
    except (cv2.error, SystemError):
        raise ValueError(f"{name} is empty, damaged or not OpenCV YAML") from None
    if not storage.isOpened():
        raise ValueError(f"{name} is not OpenCV YAML")
    return storage


def _names(storage: cv2.FileStorage) -> list[str]:
    node = storage.getNode("names")
    entries = [node.at(i) for i in range(node.size())] if node.isSeq() else []
    return [entry.string() for entry in entries if entry.isString()]


def _matrix(storage: cv2.FileStorage, name: str, *keys: str) -> list[float]:
    """Numbers of the first of the matrices that exists, row by row. Raises ValueError, naming the camera, if none does.

    FileNode.mat() is not used: with a wrong number of rows it writes beyond its memory (OpenCV 5.0).
    """
    for key in keys:
        data = storage.getNode(f"{key}_{name}")
        data = data.getNode("data") if data.isMap() else data
        if data.isSeq():
            return [_number(data.at(i), name, key) for i in range(data.size())]
    raise ValueError(f"camera {name}: {' or '.join(f'{key}_{name}' for key in keys)} is missing or damaged")


def _number(node: cv2.FileNode, name: str, what: str) -> float:
    if not (node.isReal() or node.isInt()):
        raise ValueError(f"camera {name}: {what} has something that is not a number")
    return node.real()


def _view(name: str, intrinsics: cv2.FileStorage, extrinsics: cv2.FileStorage) -> CalibratedView:
    K = numbers(name, "K", _matrix(intrinsics, name, "K"), 3, 3)
    sizes = [intrinsics.getNode(f"{key}_{name}") for key in ("W", "H")]
    size_px = [
        2 * K[axis, 2] if node.isNone() else _number(node, name, "the image size") for axis, node in enumerate(sizes)
    ]
    return CalibratedView(
        name=name,
        size_px=(round(size_px[0]), round(size_px[1])),
        K=K,
        R=rotation_matrix(name, _matrix(extrinsics, name, "Rot", "R")),
        t=numbers(name, "T", _matrix(extrinsics, name, "T"), 3),
        distortion=np.ravel(numbers(name, "dist", _matrix(intrinsics, name, "dist", "D"))),
    )
