"""The columns of a table in which every row is a detected joint: pixels, confidence, per-view 3D and its covariance."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Int

from fgpose.io.tables import COVARIANCE_COLUMNS, Column, names, numbers, symmetric
from fgpose.shown.unknown_names import check_names
from fgpose.skeleton import Skeleton

if TYPE_CHECKING:
    import pyarrow as pa

_COLUMNS_2D = ("x_px", "y_px")
_COLUMNS_3D = ("x_m", "y_m", "z_m")
_REQUIRED_COLUMNS = (*_COLUMNS_2D, "confidence")
DETECTION = (
    Column("x_px y_px", "px", "detection in the original image"),
    Column("confidence", "0 to 1", "of the detector; 0: not detected"),
    Column("x_m y_m z_m", "m", "the joint as this view alone gives it, in the world; if there is per-view 3D"),
    Column(" ".join(COVARIANCE_COLUMNS), "m²", "its covariance"),
)


def detection_columns(arrays: Mapping[str, np.ndarray | None]) -> dict[str, np.ndarray]:
    """The columns by name, in single precision; NaN = missing.

    Args:
        arrays: points2d_px (..., 2), confidence (...), perhaps points3d_m (..., 3) and covariance3d_m2 (..., 3, 3); the
            rows are those of confidence, flat.
    """
    entries: dict[str, tuple[str, tuple[int, ...]]] = {
        **{name: ("points2d_px", (axis,)) for axis, name in enumerate(_COLUMNS_2D)},
        "confidence": ("confidence", ()),
        **{name: ("points3d_m", (axis,)) for axis, name in enumerate(_COLUMNS_3D)},
        **{name: ("covariance3d_m2", entry) for name, entry in COVARIANCE_COLUMNS.items()},
    }
    return {
        name: array[(..., *entry)].ravel().astype(np.float32)
        for name, (of, entry) in entries.items()
        if (array := arrays.get(of)) is not None
    }


def detection_arrays(table: pa.Table, spread: Callable[[np.ndarray], np.ndarray]) -> dict[str, np.ndarray]:
    """The arrays that detection_columns had; a joint without a row is NaN with confidence 0.

    Args:
        table: checked by require_columns.
        spread: puts a column into an array (...) of all detections, NaN where there is no row.

    Raises:
        ValueError: a column does not contain numbers.
    """

    def points(*columns: str) -> np.ndarray:
        return np.stack([spread(numbers(table, name)) for name in columns], axis=-1)

    found = {
        "points2d_px": points(*_COLUMNS_2D),
        "confidence": np.nan_to_num(spread(numbers(table, "confidence"))),
    }
    if set(_COLUMNS_3D) <= set(table.column_names):
        found["points3d_m"] = points(*_COLUMNS_3D)
    if set(COVARIANCE_COLUMNS) <= set(table.column_names):
        found["covariance3d_m2"] = symmetric(lambda name: spread(numbers(table, name)))
    return found


def joint_indices(table: pa.Table, skeleton: Skeleton, *, may_lack: bool = False) -> np.ndarray:
    """The joint of each row, -1: none.

    Raises:
        ValueError: one is not of the skeleton, or a row has none and may not lack it.
    """
    joints, index = names(table, "joint", may_lack=may_lack)
    check_names(joints, skeleton.joints, f"skeleton {skeleton.name} has no joint", "it has")
    return np.array([*(skeleton.index(joint) for joint in joints), -1], dtype=int)[index]


def repeated_row(cell: Int[np.ndarray, " row"]) -> int | None:
    """The first row whose cell of the arrays another row has too."""
    cells, counts = np.unique(cell, return_counts=True)
    return int(np.flatnonzero(cell == cells[counts > 1][0])[0]) if (counts > 1).any() else None


def require_columns(table: pa.Table, columns: tuple[str, ...]) -> None:
    """Raise ValueError if one of these, or of pixels and confidence, is missing."""
    missing = [name for name in (*columns, *_REQUIRED_COLUMNS) if name not in table.column_names]
    if missing:
        raise ValueError(f"the column {', '.join(missing)} is missing")
