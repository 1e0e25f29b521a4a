"""Cameras as tables of names and numbers: whole calibrations in JSON, and lenses alone in any such document.

Calibrations, as scripts, data sets and networks write them, have a table for each camera: by name, or in a list whose
entries have a name. The pose from world to camera is ``R`` (matrix or Rodrigues vector) and ``t``, under any of their
usual names, or ``extrinsic_matrix`` (3 or 4 rows of four).

Lenses, as a calibration with a board leaves them, are the same things under similar names: OpenCV's calibration program
writes ``camera_matrix``, ``distortion_coefficients``, ``image_width``, ``image_height`` and, for its fisheye model,
``fisheye_model``; ROS's camera_info the same with a ``distortion_model``; scripts in Python ``mtx`` and ``dist``, or
``K`` and ``D``.
"""

from __future__ import annotations

import reprlib
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from fgpose.geometry.lens import LensModel
from fgpose.io.calibration.calibrated_view import CalibratedView, Intrinsics, numbers, rotation_matrix
from fgpose.io.content import parse_json

_ROTATION = ("r", "rotation", "rotationmatrix", "rvec", "rot")
_TRANSLATION = ("t", "translation", "translationvector", "tvec", "tvecs")
_EXTRINSIC = ("extrinsicmatrix", "extrinsics", "extrinsic", "worldtocamera", "rt")
_NAMES = ("name", "id", "camera", "serial")
# Without case and underscores, the more telling first.
_MATRIX = ("cameramatrix", "intrinsicmatrix", "intrinsicmat", "intrinsics", "matrix", "mtx", "k")
_DISTORTION = (
    *("distortioncoefficients", "distortioncoeffs", "distcoeffs", "distcoeff", "distcoef"),
    *("distortions", "distortion", "dist", "d"),
)
_WIDTH, _HEIGHT = ("imagewidth", "width"), ("imageheight", "height")
_SIZE = ("imagesize", "imgsize", "size", "resolution")
_FISHEYE = ("fisheyemodel", "fisheye")
_MODEL = ("distortionmodel",)
# Names of OpenCV's fisheye model, and of the one of four to eight coefficients, in ROS.
_FISHEYE_MODELS = ("equidistant", "fisheye")
_TRUE = ("1", "true")


def json_document(content: bytes) -> Any:
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
    views = [_view(name, table) for name, table in _tables(json_document(content))]
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


def lenses(document: Mapping[str, Any], name: str) -> list[Intrinsics]:
    """The cameras of a document: one, or a table for each.

    Args:
        document: nested tables with numbers, texts of numbers, arrays, or matrices as OpenCV writes them.
        name: of the camera where the document has one.

    Raises:
        ValueError: it has no camera matrix, or a camera is incomplete; the message names it.
    """
    if value_of(document, _MATRIX) is not None:
        return [_lens(document, name)]
    tables = {str(key): table for key, table in document.items() if isinstance(table, Mapping)}
    found = [_lens(table, key) for key, table in tables.items() if value_of(table, _MATRIX) is not None]
    if not found:
        raise ValueError("no intrinsics in it: camera_matrix and distortion_coefficients are missing")
    return found


def _lens(table: Mapping[str, Any], name: str) -> Intrinsics:
    K = numbers(name, "the camera matrix", _numbers(value_of(table, _MATRIX), name), 3, 3)
    coefficients = value_of(table, _DISTORTION)
    distortion = np.zeros(0)
    if coefficients is not None:
        distortion = numbers(name, "the distortion", _numbers(coefficients, name)).ravel()
    model, fisheye = str(value_of(table, _MODEL)).casefold(), str(value_of(table, _FISHEYE)).casefold()
    lens: LensModel = "fisheye" if model in _FISHEYE_MODELS or fisheye in _TRUE else "pinhole"
    return Intrinsics(name, K, distortion, _size_px(table, name), lens)


def _size_px(table: Mapping[str, Any], name: str) -> tuple[int, int] | None:
    size = value_of(table, _SIZE)
    if size is None:
        sides = value_of(table, _WIDTH), value_of(table, _HEIGHT)
        size = None if None in sides else list(sides)
    if size is None:
        return None
    width, height = numbers(name, "the image size", _numbers(size, name), 2)
    return round(width), round(height)


def value_of(table: Mapping[str, Any], names: tuple[str, ...]) -> Any:
    """Of the first of the names, which are without case and underscores, that the table has; None if it has none."""
    plain = {str(key).replace("_", "").casefold(): value for key, value in table.items()}
    return next((plain[name] for name in names if name in plain), None)


def _numbers(value: Any, name: str) -> Any:
    """Lists of numbers, from lists, arrays, texts or OpenCV's matrices."""
    if isinstance(value, Mapping):
        return _numbers(value.get("data"), name)
    if isinstance(value, np.ndarray):
        return value
    if isinstance(value, list):
        return [_numbers(each, name) for each in value]
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"camera {name}: {reprlib.repr(value)} is not a number") from None
