"""The markers of a C3D file, read by ezc3d in a child process: on damaged files ezc3d crashes or hangs.

This file is the program of that process, so it imports fgpose only where the caller needs it: importing all of it
takes several times as long as ezc3d.
"""

from __future__ import annotations

import io
import itertools
import os
import resource
import signal
import struct
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

# Of the C3D format: the unit of all addresses, the second byte of every file, and the codes of the processors.
BLOCK_BYTES = 512
_MAGIC = 0x50
_LITTLE_ENDIAN, _DEC, _BIG_ENDIAN = 84, 85, 86
# Of the factor that scales whole numbers, negative where the data are floating point: the byte that holds its sign.
_SIGN_BYTE = {_LITTLE_ENDIAN: 3, _DEC: 1, _BIG_ENDIAN: 0}
# The header counts in 16 bits; where it is at the end of them, the true count is elsewhere.
_MAX_COUNT = 65535
# Measured: 0.1 s and 20 bytes for each megabyte and byte of a sound file; the first start of Python takes a second.
_TIME_LIMIT_S, _TIME_LIMIT_S_PER_MB = 15.0, 1.0
_MEMORY_LIMIT_BYTES, _MEMORY_LIMIT_BYTES_PER_BYTE = 2 << 30, 50
START_OFFSET = "START_OFFSET_S"
"""Parameter of fgpose: by how much the first frame is later than its number says, seconds: the sum of its numbers."""
_LABELS = "LABELS"
_PARAMETERS = ("UNITS", "RATE", "Y_SCREEN", START_OFFSET)


@dataclass(frozen=True)
class C3dSize:
    """The contents of a C3D file, as its header declares them."""

    n_markers: int
    n_frames: int | None
    """None: more than the header can count."""


def check_size(path: Path) -> C3dSize:
    """Compare the contents that a C3D file declares with its size.

    Raises:
        ValueError: it is no C3D file, or lacks some of what its header promises.
        OSError: it cannot be read.
    """
    from fgpose.plain_files import open_plain

    n_bytes = path.stat().st_size
    with open_plain(path) as file:
        header = file.read(BLOCK_BYTES)
        if len(header) < BLOCK_BYTES or header[1] != _MAGIC or header[0] == 0:
            raise ValueError("it has no C3D header")
        file.seek((header[0] - 1) * BLOCK_BYTES)
        parameters = file.read(4)
    if len(parameters) < 4 or parameters[3] not in _SIGN_BYTE:
        raise ValueError("its header points to no parameters")
    processor = parameters[3]
    order = ">" if processor == _BIG_ENDIAN else "<"
    n_markers, n_analog, first, last = struct.unpack_from(f"{order}4H", header, 2)
    (data_block,) = struct.unpack_from(f"{order}H", header, 16)
    if (header[0] - 1 + parameters[2]) * BLOCK_BYTES > n_bytes or data_block < 2:
        raise ValueError("its parameters go beyond its end: it is truncated or damaged")
    if last < first or last == _MAX_COUNT:
        return C3dSize(n_markers, None)
    is_float = header[12 + _SIGN_BYTE[processor]] & 0x80
    frame_bytes = (4 * n_markers + n_analog) * (4 if is_float else 2)
    n_frames = last - first + 1
    present = (n_bytes - (data_block - 1) * BLOCK_BYTES) // frame_bytes if frame_bytes else n_frames
    if present < n_frames:
        raise ValueError(f"it holds {max(present, 0)} of {n_frames} frames: it is truncated or damaged")
    return C3dSize(n_markers, n_frames)


def read_points(path: Path) -> dict[str, np.ndarray]:
    """The markers of a C3D file.

    Returns:
        points (4, marker, frame), residuals (marker, frame), first_frame, and those of the parameters UNITS, RATE,
        LABELS, Y_SCREEN and START_OFFSET_S of the group POINT that it has; names beyond 255, which stand in LABELS2,
        LABELS3 and so on, are among LABELS.

    Raises:
        ValueError: the file is damaged; the caller names it.
        OSError: it cannot be read.
    """
    from fgpose.io.arrays import unpack_arrays

    check_size(path)
    n_bytes = path.stat().st_size
    limit_s = _TIME_LIMIT_S + _TIME_LIMIT_S_PER_MB * n_bytes / 1e6
    memory_bytes = _MEMORY_LIMIT_BYTES + _MEMORY_LIMIT_BYTES_PER_BYTE * n_bytes
    # The paths of this process, whatever made them; -P: this folder is not one of them.
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-P", __file__, str(path.absolute()), str(memory_bytes)]
    try:
        reader = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, timeout=limit_s, env=environment, check=False
        )
    except subprocess.TimeoutExpired:
        raise ValueError(f"it is damaged: reading it took longer than {limit_s:.0f} s") from None
    if reader.returncode:
        raise ValueError(f"it is damaged: {_reason(reader)}")
    return unpack_arrays(io.BytesIO(reader.stdout))


def _reason(reader: subprocess.CompletedProcess[bytes]) -> str:
    if reader.returncode < 0:
        return f"ezc3d crashed ({signal.Signals(-reader.returncode).name})"
    lines = reader.stderr.decode("utf-8", "replace").strip().splitlines()
    return lines[-1] if lines else f"ezc3d ended with {reader.returncode}"


def _labels(group: Any) -> list[str]:
    """A parameter holds 255 names at most: the next ones are in LABELS2, and so on."""
    names = itertools.chain([_LABELS], (f"{_LABELS}{number}" for number in itertools.count(2)))
    parts = itertools.takewhile(lambda name: "value" in group.get(name, {}), names)
    return [label for name in parts for label in group[name]["value"]]


def _main(path: str, memory_bytes: int) -> None:
    """Write the arrays of read_points as npz to the standard output."""
    answer = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what ezc3d prints is no answer
    resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    import ezc3d

    file = ezc3d.c3d(path)
    group = file["parameters"]["POINT"]
    arrays = {name: np.array(list(group[name]["value"])) for name in _PARAMETERS if "value" in group.get(name, {})}
    arrays[_LABELS] = np.array(_labels(group))
    arrays["points"] = file["data"]["points"]
    arrays["residuals"] = file["data"]["meta_points"]["residuals"][0]
    arrays["first_frame"] = np.array(file["header"]["points"]["first_frame"])
    content = io.BytesIO()
    np.savez(content, allow_pickle=False, **arrays)
    answer.write(content.getvalue())
    answer.close()


if __name__ == "__main__":
    _main(sys.argv[1], int(sys.argv[2]))
