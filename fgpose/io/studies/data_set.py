"""The data set of a study: parquet files in folders subject=.../session=.../ (hive partitions), one per recording.

pandas, polars, DuckDB, Spark and R's arrow open such a folder as one table, with the columns subject and session.
"""

from __future__ import annotations

from pathlib import Path
from urllib.parse import quote

from fgpose.io.folders import shown
from fgpose.io.tables import read_table, write_table
from fgpose.plain_files import naming

# Columns of a camera have its name: they differ between the rigs of a study, and stay with the recording.
_OF_CAMERAS = ("residual_px_", "visibility_")
_FINGERPRINT = b"fgpose.fingerprint"


def part_path(data_set: Path, subject: str, session: str, trial: str) -> Path:
    """The file of a recording. Names are written as in an address, as readers of such folders expect."""
    return data_set / f"subject={_quoted(subject)}" / f"session={_quoted(session)}" / f"{_quoted(trial)}.parquet"


def _quoted(name: str) -> str:
    return quote(name, safe=" ")


def write_part(table: Path, part: Path, recording: str, trial: str, fingerprint: str) -> None:
    """Write the table of a recording as its part of a data set: with the columns recording and trial, texts as texts,
    without the columns of single cameras.

    Raises:
        ValueError: the table is damaged; the message names it.
        OSError: a file cannot be read or written.
    """
    import pyarrow as pa

    with naming(table):
        whole = read_table(table)
    names = [name for name in whole.column_names if not name.startswith(_OF_CAMERAS)]
    columns = {"recording": pa.array([recording] * len(whole)), "trial": pa.array([trial] * len(whole))}
    for name in names:
        column = whole[name]
        columns[name] = column.cast(pa.string()) if pa.types.is_dictionary(column.type) else column
    write_table(part, pa.table(columns).replace_schema_metadata({_FINGERPRINT: fingerprint}))


def part_fingerprint(part: Path) -> str | None:
    """What the part was made from; None where there is none that can be read."""
    import pyarrow.parquet as pq

    try:
        found = pq.read_schema(part).metadata or {}
    # Arrow's errors are ValueError and OSError as well.
    except (OSError, ValueError):
        return None
    return found.get(_FINGERPRINT, b"").decode("utf-8", "replace") or None


def parts_of(data_set: Path) -> list[Path]:
    """All files of a data set."""
    return shown(data_set.glob("subject=*/session=*/*.parquet"))
