"""bioCV's ``.calib``: a text of numbers for each camera, in one folder.

Width, height, the 3 x 3 intrinsic matrix, the pose from world to camera in millimetres (three rows of four, perhaps
with the last one, 0 0 0 1), and the distortion.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fgpose.io.calibration.calibrated_view import CalibratedView, numbers
from fgpose.io.content import read_content
from fgpose.io.names import not_hidden

EXTENSION = ".calib"
_MAX_BYTES = 100_000
_LAST_ROW = (0.0, 0.0, 0.0, 1.0)


def files_in(folder: Path) -> list[Path]:
    return not_hidden(folder.glob(f"*{EXTENSION}"))


def read(path: Path) -> list[CalibratedView]:
    """The cameras of a folder; of a file, all in its folder, since each holds one.

    Raises:
        ValueError: a file is damaged; the message names it.
        OSError: a file cannot be read.
    """
    return [_view(file) for file in files_in(path if path.is_dir() else path.parent) or [path]]


def _view(file: Path) -> CalibratedView:
    name = file.name.removesuffix(EXTENSION).removesuffix(".mp4")
    try:
        words = read_content(file, _MAX_BYTES).decode("utf-8-sig").replace(",", " ").split()
    except UnicodeDecodeError:
        raise ValueError(f"camera {name}: {file.name} is not a text of numbers") from None
    values = numbers(name, file.name, words)
    n_pose = 16 if tuple(values[23:27].tolist()) == _LAST_ROW else 12
    distortion = values[11 + n_pose :]
    if len(values) < 11 + 12:
        raise ValueError(f"camera {name}: {file.name} has {len(values)} numbers; it needs size, K, pose, distortion")
    pose = values[11:23].reshape(3, 4)
    return CalibratedView(
        name=name,
        size_px=(round(float(values[0])), round(float(values[1]))),
        K=values[2:11].reshape(3, 3),
        R=pose[:, :3],
        t=pose[:, 3],
        distortion=distortion if distortion.any() else np.zeros(0),
    )
