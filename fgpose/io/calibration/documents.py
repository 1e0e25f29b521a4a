"""Cameras as tables of names and numbers: whole calibrations in JSON and YAML, and lenses alone in any such document.

Calibrations, as scripts, data sets and networks write them, have a table for each camera: by name, or in a list whose
entries have a name. The pose from world to camera is ``R`` (matrix or Rodrigues vector) and ``t``, under any of their
usual names, or ``extrinsic_matrix`` (3 or 4 rows of four). ``unit`` or ``units``, of each or of all, is that of t.

Lenses, as a calibration with a board leaves them, are the same things under similar names (lens_tables.py): OpenCV's
calibration program writes ``camera_matrix``, ``distortion_coefficients``, ``image_width``, ``image_height`` and, for
its fisheye model, ``fisheye_model``; ROS's camera_info the same with a ``distortion_model``; Kalibr ``intrinsics``,
``distortion_coeffs`` and ``resolution``; scripts in Python ``mtx`` and ``dist``, or ``K`` and ``D``.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from fgpose.io.calibration.calibrated_view import (
    CalibratedView,
    Intrinsics,
    UnitOfFormat,
    numbers,
    rotation_matrix,
    unit_named,
)
from fgpose.io.calibration.lens_tables import CameraTable, as_numbers, lens_of, plain
from fgpose.io.content import parse_json

_ROTATION = ("r", "rotation", "rotationmatrix", "rvec", "rot")
_TRANSLATION = ("t", "translation", "translationvector", "tvec", "tvecs")
_EXTRINSIC = ("extrinsicmatrix", "extrinsics", "extrinsic", "worldtocamera", "rt")
_NAMES = ("name", "id", "camera", "serial")
_UNIT = ("unit", "units")


def json_document(content: bytes) -> Any:
    """Raises ValueError unless it is JSON, in which no name is given twice."""
    try:
        return parse_json(content, distinct=True)
    except UnicodeDecodeError as error:
        raise ValueError(f"it is not UTF-8 (byte {error.start}): save it as UTF-8") from None
    except ValueError as error:
        raise ValueError(f"not JSON, or a damaged file: {error}") from None


def read(document: Any) -> tuple[list[CalibratedView], UnitOfFormat]:
    """The cameras of a document, and the unit that it says it has.

    Warns:
        UserWarning: a camera is left out, for it has no pose; or nothing is said of the distortion of lenses.

    Raises:
        ValueError: it has no cameras, one is incomplete, or units contradict each other; the message names it.
    """
    tables = [CameraTable.of(name, table) for name, table in _tables(document)]
    posed = [table for table in tables if table.first(_ROTATION) is not None or table.first(_EXTRINSIC) is not None]
    if not posed:
        raise ValueError(
            "no camera with a pose in it: a calibration has for each camera K, dist, R, t (world to camera) and the "
            f"image size{_relative(tables)}"
        )
    if left_out := [table.name for table in tables if table not in posed]:
        warnings.warn(f"{', '.join(left_out)} left out: no pose (R, t) in it", stacklevel=2)
    return [_view(table, lens) for table, lens in zip(posed, _lenses(posed), strict=True)], _unit(document, posed)


def _relative(tables: Sequence[CameraTable]) -> str:
    """What else is said of a file of Kalibr."""
    is_kalibr = any("tcncnm1" in table.values for table in tables)
    return "; poses relative to the camera before (T_cn_cnm1, of Kalibr) are not read" if is_kalibr else ""


def _unit(document: Any, tables: Sequence[CameraTable]) -> UnitOfFormat:
    stated = [table.first(_UNIT) for table in tables]
    if isinstance(document, Mapping):
        stated += [value for key, value in document.items() if plain(key) in _UNIT]
    units = {unit_named(value) for value in stated if value is not None}
    if len(units) > 1:
        raise ValueError(f"its units contradict each other: {', '.join(sorted(units))}")
    return units.pop() if units else "auto"


def _tables(document: Any) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Name and table of everything that has a lens or a pose."""
    if isinstance(document, Mapping):
        inside = [value for key, value in document.items() if plain(key) == "cameras"]
        document = inside[0] if inside and isinstance(inside[0], Mapping | list) else document
    if isinstance(document, list):
        tables = [table for table in document if isinstance(table, Mapping)]
        pairs = [(_named(table, number), table) for number, table in enumerate(tables)]
    else:
        pairs = list(document.items()) if isinstance(document, Mapping) else []
    for name, table in pairs:
        if isinstance(table, Mapping):
            own = CameraTable.of(str(name), table)
            if own.has_lens or own.first((*_ROTATION, *_EXTRINSIC)) is not None:
                yield str(name), table


def _named(table: Mapping[str, Any], number: int) -> str:
    name = CameraTable.of(f"cam_{number}", table).first(_NAMES)
    return f"cam_{number}" if name is None else str(name)


def _view(table: CameraTable, lens: Intrinsics) -> CalibratedView:
    if lens.size_px is None:
        raise ValueError(f'camera {table.name}: the size of its images is missing; add it: "size": [1920, 1080]')
    extrinsic = table.first(_EXTRINSIC)
    if extrinsic is not None:
        R, t = _of_rows(table.name, as_numbers(extrinsic, table.name))
    else:
        translation = table.first(_TRANSLATION)
        if translation is None:
            raise ValueError(f"camera {table.name}: it has a rotation, and no translation (t, world to camera)")
        R = rotation_matrix(table.name, as_numbers(table.first(_ROTATION), table.name))
        t = numbers(table.name, "the translation", as_numbers(translation, table.name), 3)
    return CalibratedView(table.name, lens.size_px, lens.K, R, t, lens.distortion, lens.lens)


def _of_rows(name: str, extrinsic: Any) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, " 3"]]:
    """Rotation and translation of 3 or 4 rows of four."""
    flat = numbers(name, "the extrinsic matrix", extrinsic).ravel()
    if flat.size not in (12, 16):
        raise ValueError(f"camera {name}: the extrinsic matrix must have 3 or 4 rows of four, got {flat.size} numbers")
    rows = flat.reshape(-1, 4)
    if len(rows) == 4 and not np.allclose(rows[3], [0, 0, 0, 1]):
        is_transposed = np.allclose(rows[:, 3], [0, 0, 0, 1])
        why = ": it is transposed" if is_transposed else ""
        raise ValueError(f"camera {name}: the last row of the extrinsic matrix is not 0 0 0 1{why}")
    return rows[:3, :3], rows[:3, 3]


def lenses(document: Any, name: str) -> list[Intrinsics]:
    """The cameras of a document: one, or a table for each.

    Args:
        document: nested tables with numbers, texts of numbers, arrays, or matrices as OpenCV writes them.
        name: of the camera where the document has one.

    Warns:
        UserWarning: nothing is said of the distortion of a lens.

    Raises:
        ValueError: it has no camera matrix, or a camera is incomplete; the message names it.
    """
    if isinstance(document, Mapping) and (alone := CameraTable.of(name, document)).has_lens:
        return _lenses([alone])
    tables = [CameraTable.of(key, table) for key, table in _tables(document)]
    found = _lenses([table for table in tables if table.has_lens])
    if not found:
        raise ValueError("no intrinsics in it: camera_matrix and distortion_coefficients are missing")
    return found


def _lenses(tables: Sequence[CameraTable]) -> list[Intrinsics]:
    found = [lens_of(table) for table in tables]
    if silent := [table.name for table in tables if not table.states_distortion]:
        warnings.warn(
            f'nothing is said of the distortion of {", ".join(silent)}, which is taken to be none; "dist": [] says so',
            stacklevel=3,
        )
    return found
