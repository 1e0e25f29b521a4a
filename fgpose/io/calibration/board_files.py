"""Descriptions of calibration boards in the files of this field, as text: charuco:7x5:30mm:22mm:DICT_5X5_100."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fgpose.config import parse_toml
from fgpose.io.calibration.opencv_yaml import yaml_document
from fgpose.io.content import read_content
from fgpose.plain_files import MAX_CALIBRATION_BYTES

_CM, _INCH = 10.0, 25.4  # in millimetres
# aniposelib and OpenCV do not say in which unit; no board has squares of less than a millimetre or more than a metre.
_METRES_BELOW = 1.0
_FORMS = (
    "board = \"charuco:7x5:30mm:22mm:DICT_5X5_100\"; or Pose2Sim's Config.toml (intrinsics_corners_nb), anipose's "
    "config.toml (board_type), caliscope's [charuco], OpenCV's YAML (board_width)"
)


def board_text(path: Path) -> str:
    """The board of a file, TOML or YAML: our own, Pose2Sim's, anipose's, caliscope's or OpenCV's.

    Raises:
        ValueError: it has no board, or a damaged one; the caller names the file.
        OSError: it cannot be read.
    """
    if path.suffix.lower() == ".toml":
        document = parse_toml(read_content(path, MAX_CALIBRATION_BYTES).decode("utf-8-sig"))
    else:
        document = yaml_document(path)
    try:
        text = _of(document)
    except (KeyError, TypeError, IndexError, AttributeError) as error:
        raise ValueError(f"its board is incomplete or damaged: {error}") from None
    if text is None:
        raise ValueError(f"it has no board: expected {_FORMS}")
    return text


def _of(document: Mapping[str, Any]) -> str | None:
    """None: nothing is known to be a board."""
    if isinstance(document.get("board"), str):
        return document["board"]
    calibration = document.get("calibration")
    if isinstance(calibration, Mapping) and "board_type" in calibration:
        return _anipose(calibration)
    if isinstance(calibration, Mapping) and (found := _pose2sim(calibration)) is not None:
        return found
    if isinstance(document.get("charuco"), Mapping):
        return _caliscope(document["charuco"])
    if {"columns", "rows", "aruco_scale"} <= document.keys():
        return _caliscope(document)
    if "board_width" in document:
        return _opencv(document)
    return None


def _pose2sim(calibration: Mapping[str, Any]) -> str | None:
    """A chessboard, its sides as numbers of inner corners, millimetres."""
    table = calibration.get("calculate", calibration)
    table = table.get("intrinsics", table)
    if "intrinsics_corners_nb" not in table:
        return None
    columns, rows = table["intrinsics_corners_nb"]
    return f"chessboard:{columns}x{rows}:{float(table['intrinsics_square_size']):.6g}mm"


def _anipose(calibration: Mapping[str, Any]) -> str:
    columns, rows = calibration["board_size"]
    square_mm = _millimetres(calibration["board_square_side_length"])
    kind = str(calibration["board_type"]).lower()
    if kind == "checkerboard":
        return f"chessboard:{columns}x{rows}:{square_mm:.6g}mm"
    if kind != "charuco":
        raise ValueError(f"a board of type {kind!r} is not known: charuco and checkerboard are")
    marker_mm = _millimetres(calibration["board_marker_length"])
    bits, number = calibration["board_marker_bits"], calibration["board_marker_dict_number"]
    return f"charuco:{columns}x{rows}:{square_mm:.6g}mm:{marker_mm:.6g}mm:DICT_{bits}X{bits}_{number}"


def _caliscope(charuco: Mapping[str, Any]) -> str:
    """The squares are as large as they were measured (square_size_overide_cm), else as the sheet allows."""
    columns, rows = int(charuco["columns"]), int(charuco["rows"])
    measured_cm = charuco.get("square_size_overide_cm") or charuco.get("square_size_override_cm")
    if measured_cm:
        square_mm = _CM * float(measured_cm)
    else:
        unit_mm = {"inch": _INCH, "cm": _CM, "mm": 1.0}.get(str(charuco.get("units", "cm")))
        if unit_mm is None:
            raise ValueError(f"unknown unit {charuco['units']!r}; known: inch, cm, mm")
        square_mm = unit_mm * min(float(charuco["board_width"]) / columns, float(charuco["board_height"]) / rows)
    marker_mm = square_mm * float(charuco["aruco_scale"])
    inverted = ":inverted" if charuco.get("inverted") else ""
    return f"charuco:{columns}x{rows}:{square_mm:.6g}mm:{marker_mm:.6g}mm:{charuco['dictionary']}{inverted}"


def _opencv(document: Mapping[str, Any]) -> str:
    """What OpenCV's samples of calibration write; all values are texts."""
    size = f"{int(document['board_width'])}x{int(document['board_height'])}"
    square_mm = _millimetres(document["square_size"])
    if "marker_size" in document:
        dictionary = document.get("dictionary", "DICT_4X4_250")
        return f"charuco:{size}:{square_mm:.6g}mm:{_millimetres(document['marker_size']):.6g}mm:{dictionary}"
    return f"chessboard:{size}:{square_mm:.6g}mm"


def _millimetres(length: Any) -> float:
    length = float(length)
    return 1000 * length if length < _METRES_BELOW else length
