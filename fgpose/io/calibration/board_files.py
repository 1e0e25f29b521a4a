"""Descriptions of calibration boards in the files of this field, as text: charuco:7x5:30mm:22mm:DICT_5X5_100."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fgpose.config import parse_toml
from fgpose.io.calibration.opencv_yaml import yaml_document
from fgpose.io.content import read_content
from fgpose.plain_files import MAX_CALIBRATION_BYTES
from fgpose.shown.unknown_names import plain

_CM, _INCH = 10.0, 25.4  # in millimetres
# aniposelib and OpenCV do not say in which unit; no board has squares of less than a millimetre or more than a metre.
_METRES_BELOW = 1.0
_FORMS = (
    "board = \"charuco:7x5:30mm:22mm:DICT_5X5_100\"; or Pose2Sim's Config.toml (intrinsics_corners_nb), anipose's "
    "config.toml (board_type), caliscope's [charuco], OpenCV's YAML or XML (board_width, or "
    "BoardSize_Width and Calibrate_Pattern)"
)
# The settings of OpenCV's sample, by the keys of what it writes.
_OF_SAMPLE = {
    "BoardSize_Width": "board_width",
    "BoardSize_Height": "board_height",
    "Square_Size": "square_size",
    "Marker_Size": "marker_size",
    "ArUco_Dict_Name": "dictionary",
    "Calibrate_Pattern": "pattern",
}
# CIRCLES_GRID is missing: rows that are not staggered look the same after half a turn.
_PATTERNS = {
    "chessboard": "chessboard",
    "checkerboard": "chessboard",
    "charuco": "charuco",
    "charucoboard": "charuco",
    "acircles": "circles",
    "asymmetriccirclesgrid": "circles",
}


def board_text(path: Path) -> str:
    """The board of a file, TOML, YAML or XML: our own, Pose2Sim's, anipose's, caliscope's or OpenCV's.

    Raises:
        ValueError: it has no board, or a damaged one; the caller names the file.
        OSError: it cannot be read.
    """
    if path.suffix.lower() == ".toml":
        document = parse_toml(read_content(path, MAX_CALIBRATION_BYTES).decode("utf-8-sig"))
    elif path.suffix.lower() == ".xml":
        document = _xml_document(path)
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
    settings = document.get("Settings", document)
    settings = {_OF_SAMPLE.get(key, key): value for key, value in settings.items()}
    return _opencv(settings) if "board_width" in settings else None


def _pose2sim(calibration: Mapping[str, Any]) -> str | None:
    """A chessboard, its sides as numbers of inner corners, millimetres."""
    table = calibration.get("calculate", calibration)
    table = table.get("intrinsics", table)
    if "intrinsics_corners_nb" not in table:
        return None
    columns, rows = table["intrinsics_corners_nb"]
    return f"chessboard:{columns}x{rows}:{float(table['intrinsics_square_size']):.6g}mm"


def _anipose(calibration: Mapping[str, Any]) -> str:
    kind = str(calibration["board_type"]).lower()
    if kind not in ("charuco", "checkerboard"):
        raise ValueError(f"a board of type {kind!r} is not known: charuco and checkerboard are")
    columns, rows = calibration["board_size"]
    square_mm = _millimetres(calibration["board_square_side_length"])
    if kind == "checkerboard":
        return f"chessboard:{columns}x{rows}:{square_mm:.6g}mm"
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


def _opencv(settings: Mapping[str, Any]) -> str:
    """What OpenCV's samples of calibration read and write; all values are texts."""
    pattern = settings.get("pattern", "charuco" if "marker_size" in settings else "chessboard")
    kind = _PATTERNS.get(plain(str(pattern)))
    if kind is None:
        raise ValueError(
            f"a board of the pattern {pattern!r} is not known: CHESSBOARD, CHARUCOBOARD and ASYMMETRIC_CIRCLES_GRID are"
        )
    text = f"{kind}:{int(settings['board_width'])}x{int(settings['board_height'])}"
    text += f":{_millimetres(settings['square_size']):.6g}mm"
    if kind == "charuco":
        dictionary = settings.get("dictionary", "DICT_4X4_250")
        text += f":{_millimetres(settings['marker_size']):.6g}mm:{dictionary}"
    return text


def _xml_document(path: Path) -> dict[str, Any]:
    """The settings of OpenCV's sample, or what it writes: of each element the text, without quotes."""
    try:
        root = ElementTree.fromstring(read_content(path, MAX_CALIBRATION_BYTES))
    except (ElementTree.ParseError, LookupError) as error:
        raise ValueError(f"it is damaged or not OpenCV's XML: {error}") from None
    settings = root.find("Settings")
    return {each.tag: (each.text or "").strip().strip('"') for each in (root if settings is None else settings)}


def _millimetres(length: Any) -> float:
    length = float(length)
    return 1000 * length if length < _METRES_BELOW else length
