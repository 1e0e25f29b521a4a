"""The cameras in the recording of a live system."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fgpose.geometry.camera import CameraRig
from fgpose.io.calibration import npz_format
from fgpose.io.calibration.calibrated_view import CalibratedView
from fgpose.io.content import first_bytes
from fgpose.io.live.packing import unpacked
from fgpose.io.live.record_files import MAGIC, RecordFile


def is_live(path: Path) -> bool:
    """Whether a file is the recording of a live system, by its content. Raises OSError if it cannot be read."""
    return first_bytes(path, len(MAGIC)) == MAGIC


def read(path: Path) -> list[CalibratedView]:
    """Cameras of a recording, in metres. Raises ValueError if it is damaged; the caller names it."""
    start = next(iter(RecordFile(path)), None)
    document = None if start is None else unpacked(start)
    if not isinstance(document, dict) or not isinstance(document.get("rig"), dict):
        raise ValueError("the recording does not begin with its cameras")
    return npz_format.views({name: _array(name, value) for name, value in document["rig"].items()})


def as_document(rig: CameraRig) -> dict[str, Any]:
    """A rig as read reads it, exactly."""
    arrays = npz_format.rig_arrays(rig)
    return {name: array.tolist() if array.dtype.kind == "U" else array for name, array in arrays.items()}


def _array(name: str, value: Any) -> np.ndarray:
    """An array, or a list of texts."""
    if isinstance(value, list) and all(isinstance(text, str) for text in value):
        return np.array(value, dtype=str)
    if not isinstance(value, np.ndarray):
        raise ValueError(f"{name} of the rig is neither an array nor a list of texts")
    return value
