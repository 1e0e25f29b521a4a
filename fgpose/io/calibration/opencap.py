"""OpenCap's cameras: one ``cameraIntrinsicsExtrinsics.pickle`` in the folder of each, ``Videos/Cam0``.

A dictionary with intrinsicMat, distortion, imageSize, rotation and translation (world to camera, millimetres). The
world is that of a checkerboard, whose up depends on how it was placed.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fgpose.io.calibration.calibrated_view import CalibratedView, numbers, rotation_matrix
from fgpose.io.content import read_content
from fgpose.io.names import natural_key
from fgpose.io.pickles import unpickled

FILE_NAME = "cameraIntrinsicsExtrinsics.pickle"
_MAX_BYTES = 1_000_000
_KEYS = ("intrinsicMat", "distortion", "imageSize", "rotation", "translation")


def is_pickle(content: bytes) -> bool:
    """By its beginning, of protocol 2 or later."""
    return content[:1] == b"\x80" and content[1:2] in (b"\x02", b"\x03", b"\x04", b"\x05")


def files_in(folder: Path) -> list[Path]:
    """The files of the cameras below a folder: of a session, its Videos, or of one camera."""
    for pattern in (FILE_NAME, f"*/{FILE_NAME}", f"Videos/*/{FILE_NAME}"):
        found = (file for file in folder.glob(pattern) if not file.parent.name.startswith("."))
        if files := sorted(found, key=lambda file: natural_key(file.parent.name)):
            return files
    return []


def read(path: Path) -> list[CalibratedView]:
    """The cameras of a folder; of a file, those of the folders beside its own too.

    Raises:
        ValueError: a file is damaged, lacks something, or is a pickle of something else; the message names it.
        OSError: a file cannot be read.
    """
    files = files_in(path) if path.is_dir() else files_in(path.parent.parent) if path.name == FILE_NAME else []
    return [_view(file) for file in files or [path]]


def _view(file: Path) -> CalibratedView:
    name = file.absolute().parent.name if file.name == FILE_NAME else file.stem
    try:
        content = unpickled(read_content(file, _MAX_BYTES))
    except ValueError as error:
        raise ValueError(f"{file.name} of camera {name}: {error}") from None
    missing = [key for key in _KEYS if not isinstance(content, dict) or key not in content]
    if missing:
        raise ValueError(f"camera {name}: a pickle, but none of OpenCap's cameras: {', '.join(missing)} is missing")
    K = numbers(name, "intrinsicMat", content["intrinsicMat"], 3, 3)
    return CalibratedView(
        name=name,
        size_px=_size_px(content["imageSize"], K, name),
        K=K,
        R=rotation_matrix(name, content["rotation"]),
        t=numbers(name, "translation", content["translation"], 3),
        distortion=numbers(name, "distortion", content["distortion"]).ravel(),
    )


def _size_px(size: Any, K: np.ndarray, name: str) -> tuple[int, int]:
    """Height and width where OpenCap calibrated the cameras, width and height where they are Vicon's: the order in
    which the principal point is nearer to the middle."""
    height, width = numbers(name, "imageSize", size, 2).tolist()
    orders = [(round(width), round(height)), (round(height), round(width))]
    if min(orders[0]) <= 0:
        raise ValueError(f"camera {name}: imageSize must be positive, got {height:g}, {width:g}")
    return min(orders, key=lambda order: abs(K[0, 2] / order[0] - 0.5) + abs(K[1, 2] / order[1] - 0.5))
