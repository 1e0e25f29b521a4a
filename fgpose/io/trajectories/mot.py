"""MOT, the motion file of OpenSim: coordinates of a model over time."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import islice
from pathlib import Path

import numpy as np
from jaxtyping import Float

from fgpose.io.atomic import write_text
from fgpose.io.content import read_content, text_lines
from fgpose.plain_files import naming

_N_HEADER_LINES = 1000  # OpenSim writes about ten


def write_mot(coordinates: Mapping[str, Float[np.ndarray, " frame"]], time_s: np.ndarray, path: Path) -> None:
    """Write coordinates with the header of OpenSim 4: angles in degrees, lengths in metres.

    OpenSim's Storage, with which its GUI opens motions, stops reading at the first value that is no number. So values
    are interpolated in time where they are NaN, at the ends the nearest one is held, and coordinates that are never
    known are left out: a model keeps its own value of those.

    Raises:
        ValueError: no coordinate is known in any frame.
        OSError: the file cannot be written.
    """
    known = {name: values for name, values in coordinates.items() if np.isfinite(values).any()}
    if not known:
        raise ValueError(f"{path}: no coordinate is known in any frame: there is no motion to be written")
    time_s = np.asarray(time_s, dtype=float)
    table = np.column_stack([time_s, *(_without_gaps(values, time_s) for values in known.values())])
    header = ["Coordinates", "version=1", f"nRows={len(table)}", f"nColumns={table.shape[1]}", "inDegrees=yes", ""]
    header += ["Units are S.I. units (second, meters, Newtons, ...)", "Angles are in degrees.", "", "endheader"]
    # Tabs, and numbers as short as they read back the same.
    rows = ["\t".join(map(repr, row)) for row in table.tolist()]
    write_text(path, "\n".join([*header, "\t".join(["time", *known]), *rows]) + "\n")


def _without_gaps(values: Float[np.ndarray, " frame"], time_s: Float[np.ndarray, " frame"]) -> np.ndarray:
    """Interpolated the shorter way round a circle of 360; lengths in metres are far from one."""
    known = np.isfinite(values)
    found = values[known]
    unwrapped = np.unwrap(found, period=360.0)
    last_found = np.maximum(np.cumsum(known) - 1, 0)
    between = np.interp(time_s, time_s[known], unwrapped) - (unwrapped - found)[last_found]
    return np.where(known, values, between)


def read_mot(path: Path) -> tuple[dict[str, Float[np.ndarray, " frame"]], Float[np.ndarray, " frame"]]:
    """Coordinates in degrees and metres by name, and the times, of a motion file of OpenSim (.mot, .sto).

    Raises:
        ValueError: it lacks its header or a number, or its angles are in radians; the message names the line.
        OSError: it cannot be read.
    """
    with naming(path, "not a readable motion file of OpenSim"):
        return _parsed(read_content(path))


def _parsed(content: bytes) -> tuple[dict[str, Float[np.ndarray, " frame"]], Float[np.ndarray, " frame"]]:
    lines = enumerate((line.strip() for line in text_lines(content)), 1)
    in_degrees = False
    for _, line in islice(lines, _N_HEADER_LINES):
        if line == "endheader":
            break
        in_degrees |= line.replace(" ", "") == "inDegrees=yes"
    else:
        raise ValueError(f"it has no line endheader among the first {_N_HEADER_LINES}")
    if not in_degrees:
        raise ValueError("angles in degrees are needed (inDegrees=yes)")
    rows = ((number, line) for number, line in lines if line)
    names = next(rows, (0, ""))[1].split()
    if names[:1] != ["time"] or len(set(names)) < len(names):
        raise ValueError("after endheader the names of the columns are needed, time first, no name twice")
    table = np.array([_numbers(line, number, names) for number, line in rows]).reshape(-1, len(names))
    return dict(zip(names[1:], table[:, 1:].T, strict=True)), table[:, 0]


def _numbers(line: str, number: int, names: list[str]) -> Float[np.ndarray, " column"]:
    try:
        values = np.array([float(cell) for cell in line.split()])
    except ValueError as error:
        raise ValueError(f"line {number}: {error}") from None
    if len(values) != len(names):
        raise ValueError(f"line {number} has {len(values)} of {len(names)} columns")
    return values
