"""TRC, the marker file of OpenSim and Pose2Sim.

Tab separated: three lines of header (the second names the values of the third), one with the markers' names, one with
X1 Y1 Z1 ..., perhaps an empty one, then the frames. OpenSim's axes are x forward, y up, z right.
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Iterator
from dataclasses import replace
from itertools import chain, islice
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.geometry.up_axis import WorldUp, y_up
from fgpose.io.atomic import write_lines
from fgpose.io.content import read_content, text_lines
from fgpose.io.tables import Column, as_cell, name_in_cell, one_line
from fgpose.io.trajectories.markers import (
    constant_rate_hz,
    markers_to_trajectory,
    without_subject,
    without_zeros,
)
from fgpose.io.trajectories.result_table import numbered
from fgpose.kinematics.body_size import leg_length
from fgpose.plain_files import check_expansion
from fgpose.sampling import parts_of
from fgpose.shown.joint_meanings import marker_names
from fgpose.skeleton import MAX_JOINTS
from fgpose.trajectory import Trajectory

_HEADER = ["DataRate", "CameraRate", "NumFrames", "NumMarkers", "Units"]
_HEADER += ["OrigDataRate", "OrigDataStartFrame", "OrigNumFrames"]
_UNITS_PER_METRE = {"m": 1.0, "cm": 100.0, "mm": 1000.0}
_SEPARATORS = ("\t", ";", ",")
_N_HEADER_LINES = 5  # of the TRC format
_NUMBER = re.compile(r"[0-9]{1,9}")
COLUMNS = (
    Column("Frame#", "", "number of the frame in the recording, from 1; frames in which nobody is there have no row"),
    Column("Time", "s", "time of the frame"),
    Column(
        "<marker>",
        "m",
        "three cells, x, y and z, with y up; [named as in Pose2Sim's models](formats.md#trc) (`RHip`)",
    ),
)


def write_trc(trajectory: Trajectory, path: Path, world_up: WorldUp = "z", made_by: str = "") -> None:
    """Write positions in metres with y up; gaps are cells "nan", as OpenSim writes them.

    Markers have marker_names, those of Pose2Sim's OpenSim models (RHip). The Time column holds the true times; DataRate
    is their rate over the whole recording, without gaps (1 for a single frame). Frame# counts the frames of the
    recording from 1. Frames in which nobody is there have no row: at one OpenSim's inverse kinematics ends.

    Args:
        world_up: what is up in the trajectory's world; z is mapped to OpenSim's y as Pose2Sim does.
        made_by: see Origin.maker; it is then said behind the name of the file in the first line.

    Raises:
        ValueError: the times do not increase.
        OSError: the file cannot be written.
    """
    file_name = one_line(f"{path.name} (made by fgpose {made_by})" if made_by else path.name)
    n_rows = sum(int(_there(trajectory, part).sum()) for part in parts_of(trajectory.n_frames))
    write_lines(path, chain(_header_lines(trajectory, n_rows, file_name), _frame_lines(trajectory, world_up)))


def _there(trajectory: Trajectory, part: slice) -> Bool[np.ndarray, " frame"]:
    """In which of some frames a joint is known."""
    return np.asarray(np.isfinite(trajectory.positions_m[part]).all(axis=-1).any(axis=-1))


def _header_lines(trajectory: Trajectory, n_rows: int, file_name: str) -> list[str]:
    rate = f"{constant_rate_hz(trajectory.time_s):.10g}"
    n_frames, n_markers = str(n_rows), trajectory.skeleton.n_joints
    names = [cell for name in marker_names(trajectory.skeleton.joints) for cell in (as_cell(name), "", "")]
    axes = [f"{axis}{marker}" for marker in range(1, n_markers + 1) for axis in "XYZ"]
    return [
        "\t".join(["PathFileType", "4", "(X/Y/Z)", file_name]),
        "\t".join(_HEADER),
        "\t".join([rate, rate, n_frames, str(n_markers), "m", rate, "1", n_frames]),
        "\t".join(["Frame#", "Time", *names]),
        "\t".join(["", "", *axes]),
    ]


def _frame_lines(trajectory: Trajectory, world_up: WorldUp) -> Iterator[str]:
    numbers = numbered(trajectory) + 1
    for part in parts_of(trajectory.n_frames):
        there = _there(trajectory, part)
        in_world_m = trajectory.positions_m[part][there]
        known = np.isfinite(in_world_m).all(axis=-1, keepdims=True)
        positions_m = np.where(known, y_up(in_world_m, world_up), np.nan)
        rows = positions_m.reshape(len(positions_m), 3 * trajectory.skeleton.n_joints).tolist()
        times_s = np.asarray(trajectory.time_s[part][there], dtype=float).tolist()
        for number, time_s, row in zip(numbers[part][there].tolist(), times_s, rows, strict=True):
            # repr is the shortest text that reads back as the same number. OpenSim refuses a row whose last cell is
            # empty.
            yield "\t".join([str(number), repr(time_s), *map(repr, row)])


def read_trc(path: Path) -> Trajectory:
    """Read the markers of a TRC file, in metres and the axes of the file.

    Lenient where writers differ: NumFrames and NumMarkers are not believed, Frame# where it increases; rows may lack
    trailing cells, empty lines are skipped, a cell "nan" and a marker at exactly (0, 0, 0) are gaps. Cells may be
    separated by semicolons or commas, as a table program leaves them, and numbers may have decimal commas where no cell
    has a point.
    Where no unit is named, the legs of the body tell it.

    Warns:
        UserWarning: no unit is named, or one that makes a giant or a dwarf; which one was taken. Or there are zeros, or
            several subjects.

    Raises:
        ValueError: the header is not that of a TRC file, the unit is not m, cm or mm, or is not named and not told by a
            body, a cell is not a number; the message names line and marker.
    """
    content = read_content(path)
    header = list(islice(text_lines(content), _N_HEADER_LINES))
    if len(header) < _N_HEADER_LINES or not header[0].startswith("PathFileType"):
        raise ValueError("it lacks the five header lines of a TRC file")
    separator = next((each for each in _SEPARATORS if each in header[3]), "\t")
    markers = without_subject(_markers(header[3], separator), path)
    table, numbers = _frames(content, separator, markers)
    positions = without_zeros(markers, table[:, 1:].reshape(len(table), len(markers), 3), path)
    in_file = markers_to_trajectory(markers, table[:, 0], positions)
    unit = _checked_unit(_unit(header, separator), leg_length(in_file), path)
    in_metres = in_file.positions_m / _UNITS_PER_METRE[unit]
    return replace(in_file, positions_m=in_metres, frame_numbers=_frame_numbers(numbers))


def _markers(line: str, separator: str) -> list[str]:
    """The names in line 4, each of which has three cells."""
    markers = [name_in_cell(name.strip()) for name in line.split(separator)[2:] if name.strip()]
    if not 1 <= len(markers) <= MAX_JOINTS:
        raise ValueError(
            f"line 4 names {len(markers) or 'no'} markers, at least one and at most {MAX_JOINTS} are needed"
        )
    return markers


def _frames(content: bytes, separator: str, markers: list[str]) -> tuple[Float[np.ndarray, "frame cell"], list[str]]:
    """Time and coordinates, in the file's units; and the first cells."""
    n_cells = 1 + 3 * len(markers)
    # Frame numbers have no point, and what stands before them in the first line of them no frame.
    has_points = any("." in line for line in islice(text_lines(content), _N_HEADER_LINES, None))
    decimal_commas = separator != "," and not has_points
    rows: list[np.ndarray] = []
    numbers: list[str] = []
    for number, line in enumerate(islice(text_lines(content), _N_HEADER_LINES, None), _N_HEADER_LINES + 1):
        if line.replace(separator, "").strip():
            # Rows may be much shorter than the header says.
            check_expansion(8 * n_cells * (len(rows) + 1), len(content))
            line = line.replace(",", ".") if decimal_commas else line
            rows.append(_parse_frame(line, separator, number, markers))
            numbers.append(line.split(separator, 1)[0].strip())
    return np.array(rows).reshape(len(rows), n_cells), numbers


def _frame_numbers(cells: list[str]) -> Int[np.ndarray, " frame"] | None:
    """From 0, by cells that count from 1, or from 0 as some writers do; None where they do not increase."""
    if not all(_NUMBER.fullmatch(cell) for cell in cells):
        return None
    numbers = np.array([int(cell) for cell in cells], dtype=int)
    if len(numbers) and (np.diff(numbers) > 0).all():
        return numbers - min(int(numbers[0]), 1)
    return None


def _unit(lines: list[str], separator: str) -> str:
    """As line 3 says; empty where it says nothing."""
    names = [name.strip().lower() for name in lines[1].split(separator)]
    values = [value.strip() for value in lines[2].split(separator)]
    if "units" not in names:
        # Some writers separate the header by blanks.
        names, values = lines[1].lower().split(), lines[2].split()
    unit = dict(zip(names, values, strict=False)).get("units", "").lower()
    if unit and unit not in _UNITS_PER_METRE:
        raise ValueError(f"line 3: Units must be m, cm or mm, got {unit}")
    return unit


def _checked_unit(said: str, leg: float, path: Path) -> str:
    """The unit that the file names, unless legs of that length belong to nobody.

    Args:
        said: in line 3; empty: nothing.
        leg: length of the legs in the file; NaN: it has none.
        path: the file.
    """
    if said and not (np.isfinite(leg) and not _is_leg(leg, said)):
        return said
    fitting = [unit for unit in _UNITS_PER_METRE if _is_leg(leg, unit)]
    if not fitting and said:
        return said
    if not fitting:
        raise ValueError("line 3: Units is missing, and no legs of a person tell it; write m, cm or mm there")
    why = f"line 3 says {said}, in which legs are {leg:.3g} long" if said else "line 3 names no unit"
    warnings.warn(f"{path}: {why}: lengths are taken to be {fitting[0]}, which fits a person", stacklevel=5)
    return fitting[0]


def _is_leg(leg: float, unit: str) -> bool:
    """Whether legs of a small child up to a very tall man are this long; the units are further apart than these."""
    return 0.25 < leg / _UNITS_PER_METRE[unit] < 1.3


def _parse_frame(line: str, separator: str, line_number: int, markers: list[str]) -> Float[np.ndarray, " cell"]:
    """Time and coordinates of one line, in the file's units; NaN in gaps."""
    n_cells = 1 + 3 * len(markers)
    cells = line.split(separator)[1:]
    if any(cell.strip() for cell in cells[n_cells:]):
        raise ValueError(f"line {line_number}: there are more cells than {len(markers)} markers need")
    values = np.full(n_cells, np.nan)
    for index, cell in enumerate(map(str.strip, cells[:n_cells])):
        if not cell:
            continue
        try:
            values[index] = float(cell)
        except ValueError:
            where = markers[(index - 1) // 3] if index else "Time"
            raise ValueError(f"line {line_number}, {where}: {cell!r} is not a number") from None
    if not math.isfinite(values[0]):
        raise ValueError(f"line {line_number}: there is no time")
    return values
