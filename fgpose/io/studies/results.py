"""The results of a study: tables whose rows are dictionaries, data sets, and no links in them.

A data set is parquet files in folders subject=.../session=.../ (hive partitions), one per recording. pandas, polars,
DuckDB, Spark and R's arrow open such a folder as one table, with the columns subject and session.
"""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

from fgpose.io.atomic import write_text
from fgpose.io.names import not_hidden
from fgpose.io.tables import Column, as_cell, read_table, write_table
from fgpose.plain_files import naming

STUDY_NAME = "fgpose.study"
"""Key of the metadata that holds how the study is called."""
WORLD_UP = "fgpose.world_up"
"""The same for the axis that points up."""
# Columns of a camera have its name: they differ between the rigs of a study, and stay with the recording.
_OF_CAMERAS = ("residual_px_", "visibility_")
_FINGERPRINT = b"fgpose.fingerprint"
# What fgpose study and fgpose report write into the folder of the results.
_FOLDERS = ("recordings", "motion", "angles")
_FILES = ("quality.csv", "quality.parquet", "events.parquet", "report.html")
LOCK = ".lock"
"""In that folder while a study is at work, and from then on."""
OF_PARTS = (
    Column("recording", "", "subject/session/trial"),
    Column("trial", "", "its last part; `subject` and `session` are in the names of the folders"),
)


def write_rows(rows: Sequence[Mapping[str, Any]], path: Path, metadata: Mapping[str, str] | None = None) -> None:
    """Write a table, as .parquet or .csv, by the extension. Its columns are those of any row, in the order in which
    they first occur; what a row lacks is empty. A parquet file holds the metadata too. Texts of a CSV file are written
    as cells.as_cell does.

    Raises:
        OSError: the file cannot be written; the message names it.
    """
    columns = list(dict.fromkeys(name for row in rows for name in row))
    if path.suffix == ".parquet":
        import pyarrow as pa

        table = pa.table({name: [row.get(name) for row in rows] for name in columns})
        write_table(path, table.replace_schema_metadata(dict(metadata or {})))
        return
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(
        {n: as_cell(value) if isinstance(value, str) else value for n, value in row.items()} for row in rows
    )
    write_text(path, text.getvalue())


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
    return not_hidden(data_set.glob("subject=*/session=*/*.parquet"))


def are_results(path: Path) -> bool:
    """Whether a folder is the output of a study, or holds such and nothing else. False where it cannot be listed."""
    if _is_output(path):
        return True
    try:
        with os.scandir(path) as entries:
            inside = (Path(entry.path) for entry in entries if not entry.name.startswith("."))
            first = next(inside, None)
            # The first that is none ends it: folders of keypoints have a file for each image.
            return first is not None and _is_output(first) and all(map(_is_output, inside))
    except OSError:
        return False


def _is_output(folder: Path) -> bool:
    """A study that was killed has no table of quality yet."""
    has_file = any(os.path.isfile(folder / name) for name in ("quality.parquet", LOCK))
    return has_file and os.path.isdir(folder / "recordings")


def check_unlinked(results: Path) -> None:
    """Make sure that what is read and written as a result of a study is in the folder of its results. The folder itself
    may be a link, and so may anything in it that fgpose does not write.

    Raises:
        OSError: there is a link, or a folder that cannot be listed; the message names it.
    """
    for path in (results / name for name in (*_FOLDERS, *_FILES)):
        link = path if path.is_symlink() else next(_links(path), None) if path.is_dir() else None
        if link is not None:
            raise OSError(
                f"{link} is a link, to {os.readlink(link)}: results of a study are neither read nor written through "
                "links, for a study of somebody else could name any file. Remove it; output in the study file may name "
                "another folder, and inputs may be links"
            )


def _links(folder: Path) -> Iterator[Path]:
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.is_symlink():
                yield Path(entry.path)
            elif entry.is_dir():
                yield from _links(Path(entry.path))
