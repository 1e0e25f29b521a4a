"""Calibrations in JSON, as scripts, data sets and networks write them: a table for each camera.

A table by name, or a list whose entries have a name. The lens as in lens_documents; the pose from world to camera as
``R`` (matrix or Rodrigues vector) and ``t``, under any of their usual names, or as ``extrinsic_matrix`` (3 or 4 rows of
four).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from fgpose.io.calibration.calibrated_view import CalibratedView, numbers, rotation_matrix
from fgpose.io.calibration.lens_documents import lenses, value_of
from fgpose.io.content import parse_json

_ROTATION = ("r", "rotation", "rotationmatrix", "rvec", "rot")
_TRANSLATION = ("t", "translation", "translationvector", "tvec", "tvecs")
_EXTRINSIC = ("extrinsicmatrix", "extrinsics", "extrinsic", "worldtocamera", "rt")
_NAMES = ("name", "id", "camera", "serial")


def document_of(content: bytes) -> Any:
    """Raises ValueError unless it is JSON."""
    try:
        return parse_json(content)
    except ValueError as error:
        raise ValueError(f"not JSON, or a damaged file: {error}") from None


def read(content: bytes) -> list[CalibratedView]:
    """The cameras of a document.

    Raises:
        ValueError: it is damaged, has no cameras, or one is incomplete; the message names it.
    """
    views = [_view(name, table) for name, table in _tables(document_of(content))]
    if not views:
        raise ValueError(
            "no camera with a pose in it: a calibration has for each camera K, dist, R, t (world to camera) and the "
            "image size"
        )
    return views


def _tables(document: Any) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Name and table of everything that has a pose."""
    if isinstance(document, Mapping) and isinstance(value_of(document, ("cameras",)), Mapping | list):
        document = value_of(document, ("cameras",))
    if isinstance(document, list):
        tables = [table for table in document if isinstance(table, Mapping)]
        pairs = [(str(_named(table, number)), table) for number, table in enumerate(tables)]
    else:
        pairs = list(document.items()) if isinstance(document, Mapping) else []
    for name, table in pairs:
        if isinstance(table, Mapping) and (value_of(table, _ROTATION) or value_of(table, _EXTRINSIC)) is not None:
            yield str(name), table


def _named(table: Mapping[str, Any], number: int) -> Any:
    name = value_of(table, _NAMES)
    return f"cam_{number}" if name is None else name


def _view(name: str, table: Mapping[str, Any]) -> CalibratedView:
    (lens,) = lenses({**table}, name)
    if lens.size_px is None:
        raise ValueError(f'camera {name}: the size of its images is missing; add it: "size": [1920, 1080]')
    extrinsic = value_of(table, _EXTRINSIC)
    if extrinsic is not None:
        flat = numbers(name, "the extrinsic matrix", extrinsic).ravel()
        if flat.size not in (12, 16):
            raise ValueError(
                f"camera {name}: the extrinsic matrix must have 3 or 4 rows of four, got {flat.size} numbers"
            )
        R, t = flat[:12].reshape(3, 4)[:, :3], flat[:12].reshape(3, 4)[:, 3]
    else:
        R = rotation_matrix(name, value_of(table, _ROTATION))
        t = numbers(name, "the translation", value_of(table, _TRANSLATION), 3)
    return CalibratedView(name, lens.size_px, lens.K, R, t, lens.distortion, lens.lens)
