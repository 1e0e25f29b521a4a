"""TRC, the marker file of OpenSim and Pose2Sim.

Tab separated: three lines of header (the second names the values of the third), one with the markers' names, one with
X1 Y1 Z1 ..., perhaps an empty one, then the frames. OpenSim's axes are x forward, y up, z right.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from jaxtyping import Float

from fgpose.io.atomic import write_text
from fgpose.io.content import read_content
from fgpose.io.markers import UpAxis, from_y_up, marker_of_joint, markers_to_trajectory, median_rate_hz, to_y_up
from fgpose.trajectory import Trajectory

_HEADER = ["DataRate", "CameraRate", "NumFrames", "NumMarkers", "Units"]
_HEADER += ["OrigDataRate", "OrigDataStartFrame", "OrigNumFrames"]
_UNITS_PER_METRE = {"m": 1.0, "mm": 1000.0}
_N_HEADER_LINES = 5  # of the TRC format


def write_trc(trajectory: Trajectory, path: Path, world_up: UpAxis = "z", made_by: str = "") -> None:
    """Write positions in metres with y up; gaps are cells "nan", as OpenSim writes them.

    Markers are named as in Pose2Sim's OpenSim models (RHip). The Time column holds the true times; DataRate is one
    over their median interval (1 for a single frame). Frame numbers count from 1.

    Args:
        world_up: which axis of the trajectory's world points up; z is mapped to OpenSim's y as Pose2Sim does.
        made_by: command of fgpose, which is then said behind the name of the file in the first line.

    Raises:
        ValueError: the times do not increase.
        OSError: the file cannot be written.
    """
    file_name = f"{path.name} (made by fgpose {made_by})" if made_by else path.name
    lines = [*_header_lines(trajectory, file_name), *_frame_lines(trajectory, world_up)]
    write_text(path, "\n".join(lines) + "\n")


def _header_lines(trajectory: Trajectory, file_name: str) -> list[str]:
    rate = f"{median_rate_hz(trajectory.time_s):.10g}"
    n_frames, n_markers = str(trajectory.n_frames), trajectory.skeleton.n_joints
    names = [cell for joint in trajectory.skeleton.joints for cell in (marker_of_joint(joint), "", "")]
    axes = [f"{axis}{marker}" for marker in range(1, n_markers + 1) for axis in "XYZ"]
    return [
        "\t".join(["PathFileType", "4", "(X/Y/Z)", file_name]),
        "\t".join(_HEADER),
        "\t".join([rate, rate, n_frames, str(n_markers), "m", rate, "1", n_frames]),
        "\t".join(["Frame#", "Time", *names]),
        "\t".join(["", "", *axes]),
    ]


def _frame_lines(trajectory: Trajectory, world_up: UpAxis) -> list[str]:
    known = np.isfinite(trajectory.positions_m).all(axis=-1, keepdims=True)
    positions_m = np.where(known, to_y_up(trajectory.positions_m, world_up), np.nan)
    rows = positions_m.reshape(trajectory.n_frames, 3 * trajectory.skeleton.n_joints).tolist()
    times_s = np.asarray(trajectory.time_s, dtype=float).tolist()
    return [
        # repr is the shortest text that reads back as the same number. OpenSim refuses a row whose last cell is empty.
        "\t".join([str(number), repr(time_s), *map(repr, row)])
        for number, (time_s, row) in enumerate(zip(times_s, rows, strict=True), start=1)
    ]


def read_trc(path: Path, world_up: UpAxis = "z") -> Trajectory:
    """Read the markers of a TRC file, in metres.

    Lenient where writers differ: NumFrames, NumMarkers and the frame numbers are not believed, rows may lack trailing
    cells, empty lines are skipped, a cell "nan" is a gap.

    Args:
        world_up: the axis that points up in the world wanted; the file's is y.

    Raises:
        ValueError: the header is not that of a TRC file, the unit is not m or mm, a cell is not a number; the message
            names line and marker.
    """
    lines = read_content(path).decode("utf-8-sig").splitlines()
    if len(lines) < _N_HEADER_LINES or not lines[0].startswith("PathFileType"):
        raise ValueError("it lacks the five header lines of a TRC file")
    header = dict(zip(lines[1].split(), lines[2].split(), strict=False))
    unit = header.get("Units", "none")
    if unit not in _UNITS_PER_METRE:
        raise ValueError(f"line 3: Units must be m or mm, got {unit}")
    markers = [name.strip() for name in lines[3].split("\t")[2:] if name.strip()]
    if not markers:
        raise ValueError("line 4 names no marker")
    frames = [(n, line) for n, line in enumerate(lines[_N_HEADER_LINES:], _N_HEADER_LINES + 1) if line.strip()]
    table = np.array([_parse_frame(line, number, markers) for number, line in frames])
    table = table.reshape(len(frames), 1 + 3 * len(markers))
    positions = table[:, 1:].reshape(len(frames), len(markers), 3)
    return markers_to_trajectory(markers, table[:, 0], from_y_up(positions / _UNITS_PER_METRE[unit], world_up))


def _parse_frame(line: str, line_number: int, markers: list[str]) -> Float[np.ndarray, " cell"]:
    """Time and coordinates of one line, in the file's units; NaN in gaps."""
    cells = [cell.strip() for cell in line.split("\t")][1:]
    n_cells = 1 + 3 * len(markers)
    if any(cells[n_cells:]):
        raise ValueError(f"line {line_number}: there are more cells than {len(markers)} markers need")
    values = np.full(n_cells, np.nan)
    for index, cell in enumerate(cells[:n_cells]):
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
