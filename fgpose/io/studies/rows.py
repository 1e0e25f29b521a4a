"""Tables whose rows are dictionaries, as parquet and as CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from fgpose.io.atomic import write_text
from fgpose.io.tables import write_table

_FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r", "\n")
STUDY_NAME = "fgpose.study"
"""Key of the metadata that holds how the study is called."""


def write_rows(rows: Sequence[Mapping[str, Any]], path: Path, metadata: Mapping[str, str] | None = None) -> None:
    """Write a table, as .parquet or .csv, by the extension. Its columns are those of any row, in the order in which
    they first occur; what a row lacks is empty. A parquet file holds the metadata too. In a CSV file an apostrophe
    precedes texts that a spreadsheet would take for formulas.

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
    writer.writerows({name: _as_data(value) for name, value in row.items()} for row in rows)
    write_text(path, text.getvalue())


def _as_data(value: Any) -> Any:
    """A text that no spreadsheet takes for a formula, which could send the table elsewhere: names are of the files."""
    return f"'{value}" if isinstance(value, str) and value.startswith(_FORMULA_STARTS) else value
