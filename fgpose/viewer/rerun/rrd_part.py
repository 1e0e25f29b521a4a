"""Some seconds of a recording in Rerun, as a file of their own."""

from __future__ import annotations

import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
from jaxtyping import Int
from rerun.chunk import RrdReader

from fgpose.sampling import TimeRange

_PART = "part"


def rrd_part(path: Path, wanted: TimeRange, folder: Path) -> Path:
    """What a .rrd file shows in some seconds, as a file: their frames, and what was there when they begin.

    Args:
        path: of the whole file.
        wanted: times of the recording; where they are dates, as of live recordings, seconds since its beginning.
        folder: an empty one, for the part.

    Raises:
        ValueError: the file is damaged, or no frame is in that time.
        OSError: the part cannot be written.
    """
    time_ns, begin_ns = _times_ns(path)
    try:
        inside = wanted.of((time_ns - begin_ns) / 1e9)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    first_ns, last_ns = time_ns[inside][[0, -1]].tolist()
    # Each part ends before the beginning of the next one.
    cuts = [f"--time={first_ns}", f"--time={last_ns + 1}"]
    options = ["--timeline", "time", *cuts, "--recording-id", _PART, "--output-dir", str(folder.absolute())]
    command = [sys.executable, "-m", "rerun", "rrd", "split", *options, str(path.absolute())]
    split = subprocess.run(command, check=False, capture_output=True, text=True)
    for part in folder.glob("*.rrd"):
        if _reader(part).recordings()[0].recording_id == f"{_PART}1":
            return part.rename(folder / f"{path.stem}.rrd")
        part.unlink()
    raise OSError(f"{path}: Rerun could not split it: {split.stderr.strip()[-300:]}")


def _times_ns(path: Path) -> tuple[Int[np.ndarray, " time"], int]:
    """All times, increasing; and what is subtracted from them to be seconds of the recording."""
    found, is_date = [np.zeros(0, dtype=np.int64)], False
    try:
        for chunk in _reader(path).stream().filter(has_timeline="time").to_chunks():
            column = chunk.to_record_batch()["time"]
            is_date = str(column.type).startswith("timestamp")
            found.append(np.unique(column.cast("int64").to_numpy()))
    except (ValueError, RuntimeError) as error:
        raise ValueError(f"{path}: Rerun cannot read it: {error}") from None
    time_ns = np.unique(np.concatenate(found))
    return time_ns, int(time_ns[0]) if is_date and len(time_ns) else 0


def _reader(path: Path) -> RrdReader:
    with warnings.catch_warnings():
        # Endless recordings have no footer.
        warnings.simplefilter("ignore")
        return RrdReader(path)
