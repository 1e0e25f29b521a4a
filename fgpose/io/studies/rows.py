"""Tables whose rows are dictionaries, as parquet and as CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from fgpose.io.atomic import write_text
from fgpose.io.cells import as_cell
from fgpose.io.tables import write_table

STUDY_NAME = "fgpose.study"
"""Key of the metadata that holds how the study is called."""


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
