"""Parquet tables: checked when read, written whole or not at all."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from fgpose.io.atomic import writing
from fgpose.plain_files import check_expansion, open_plain
from fgpose.skeleton import CONTROL

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq
# A table program runs a cell that begins so, which could send the table elsewhere.
_FORMULA = re.compile(r"'*[=+\-@\t\r\n]")
_CONTROLS = re.compile(f"{CONTROL.pattern}+")
LARGEST_NUMBER = 1_000_000_000
"""Of a frame or a person."""
COVARIANCE_COLUMNS = {
    f"cov_{'xyz'[row]}{'xyz'[column]}_m2": (row, column)
    for row, column in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
}
"""Row and column of the entry by the name of its column."""


class Column(NamedTuple):
    """What columns of a table that fgpose writes are, or an array of an npz file: said beside what writes them.

    The page of columns of the documentation is made of these, and a test compares them with files.
    """

    names: str
    """With blanks between them; <joint> stands for the name of one."""
    unit: str
    meaning: str
    """Markdown, as on that page."""
    shape: str = ""
    """Of an array."""


TIME_S = Column("time_s", "s", "time of the frame")
FRAME = Column("frame", "", "number of the frame, as in the result")


def read_table(path: Path, columns: list[str] | None = None) -> pa.Table:
    """The table of a parquet file: all columns, or those of the ones named that it has.

    Raises:
        ValueError: the file is damaged or something else, or two columns have one name; the caller names it.
        OSError: it cannot be opened.
    """
    import pyarrow as pa

    n_bytes = path.stat().st_size
    with _opened(path) as file:
        _check_size(file.metadata, n_bytes)
        schema = file.schema_arrow
    names = schema.names
    if len(set(names)) < len(names):
        raise ValueError(f"two columns are named {next(name for name in names if names.count(name) > 1)}")
    texts = [field.name for field in schema if pa.types.is_string(field.type) or pa.types.is_binary(field.type)]
    with _opened(path, texts) as file:
        table = file.read(columns)
        # Sizes and texts inside the columns, which Arrow does not check when it reads.
        table.validate(full=True)
        for n, name in enumerate(table.column_names):
            if pa.types.is_dictionary(table[n].type):
                _check_texts(table[n], n_bytes)
                table = table.set_column(n, name, table[n].cast(schema.field(name).type))
    return table


def column_names(path: Path) -> set[str]:
    """Names of the columns of a parquet file, whose rows are not read. Raises as read_table does."""
    with _opened(path) as file:
        return set(file.schema_arrow.names)


def file_metadata(path: Path) -> dict[str, str]:
    """The metadata of a parquet file, whose rows are not read. Raises as read_table does, and if they are no text."""
    with _opened(path) as file:
        return _texts(file.schema_arrow.metadata)


def _check_size(found: pq.FileMetaData, n_bytes: int) -> None:
    """A few bytes can stand for any number of equal rows, or for pages of any length. Raises ValueError."""
    groups = [found.row_group(n) for n in range(found.num_row_groups)]
    n_cells = max(found.num_rows * found.num_columns, sum(group.num_rows * group.num_columns for group in groups))
    check_expansion(max(8 * n_cells, sum(group.total_byte_size for group in groups)), n_bytes)


def _check_texts(column: pa.ChunkedArray, n_bytes: int) -> None:
    """A few bytes can stand for any number of equal texts, which are long. Raises ValueError."""
    import pyarrow as pa
    import pyarrow.compute

    compute: Any = pyarrow.compute
    for chunk in column.chunks:
        if pa.types.is_string(chunk.type.value_type) or pa.types.is_binary(chunk.type.value_type):
            lengths = compute.binary_length(chunk.dictionary).cast(pa.int64()).take(chunk.indices)
            check_expansion(compute.sum(lengths).as_py() or 0, n_bytes)


@contextmanager
def _opened(path: Path, as_dictionaries: Sequence[str] = ()) -> Iterator[pq.ParquetFile]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    with open_plain(path) as stream:
        try:
            yield pq.ParquetFile(stream, read_dictionary=as_dictionaries, page_checksum_verification=True)
        # Arrow's own exceptions are those of Python as well: OSError, KeyError, NotImplementedError, MemoryError, ...
        except (pa.ArrowException, ValueError, TypeError, OSError, MemoryError) as error:
            raise ValueError(f"a damaged parquet file: {error}") from None


def numbers(table: pa.Table, name: str) -> Float[np.ndarray, " row"]:
    """A column of numbers; NaN = null.

    Raises:
        ValueError: it is missing or of another kind; the caller names the file.
    """
    import pyarrow as pa

    column = _column(table, name)
    if not (pa.types.is_floating(column.type) or pa.types.is_integer(column.type) or pa.types.is_null(column.type)):
        raise ValueError(f"column {name} does not contain numbers but {column.type}")
    return column.cast(pa.float64(), safe=False).to_numpy()


def whole_numbers(values: Float[np.ndarray, " row"], name: str) -> Int[np.ndarray, " row"]:
    """Numbers of frames or people. Raises ValueError unless they are whole, from 0."""
    if not ((values >= 0) & (values <= LARGEST_NUMBER) & (values == np.floor(values))).all():
        raise ValueError(f"a row whose {name} is no number from 0 to {LARGEST_NUMBER}")
    return values.astype(int)


def names(table: pa.Table, name: str, *, may_lack: bool = False) -> tuple[tuple[str, ...], Int[np.ndarray, " row"]]:
    """A column of names: those that occur, in the order of their first occurrence, and the index of each row's.

    Args:
        table: of a file.
        name: of the column.
        may_lack: the index of a row that has none is -1 then.

    Raises:
        ValueError: it is missing or of another kind, or a row has none; the caller names the file.
    """
    import pyarrow as pa

    column = _column(table, name)
    try:
        encoded = column.cast(pa.string()).combine_chunks().dictionary_encode()
    except pa.ArrowException:
        raise ValueError(f"column {name} does not contain names but {column.type}") from None
    if isinstance(encoded, pa.ChunkedArray):
        encoded = encoded.combine_chunks()
    if encoded.null_count and not may_lack:
        raise ValueError(f"a row without a {name}")
    return tuple(encoded.dictionary.to_pylist()), encoded.indices.fill_null(-1).to_numpy().astype(np.int64)


def _column(table: pa.Table, name: str) -> pa.ChunkedArray:
    if name not in table.column_names:
        raise ValueError(f"the column {name} is missing")
    return table[name]


def nullable(values: np.ndarray) -> pa.Array:
    """A column of numbers; null where they are NaN."""
    import pyarrow as pa

    return pa.array(values, mask=np.isnan(values))


def metadata(table: pa.Table) -> dict[str, str]:
    """The metadata of the file. Raises ValueError if they are not text."""
    return _texts(table.schema.metadata)


def _texts(found: dict[bytes, bytes] | None) -> dict[str, str]:
    return {key.decode("utf-8"): text.decode("utf-8") for key, text in (found or {}).items()}


def write_table(path: Path, table: pa.Table) -> None:
    """Replace a file by a table, whole or not at all. Raises OSError, which names it, if it cannot be written."""
    write_row_groups(path, table.schema, [table])


def write_row_groups(path: Path, schema: pa.Schema, tables: Iterable[pa.Table]) -> None:
    """The same of a table that is made part by part, so that it need not be in memory: each is a group of rows."""
    import pyarrow.parquet as pq

    with (
        writing(path) as file,
        pq.ParquetWriter(file, schema, compression="zstd", write_page_checksum=True) as writer,
    ):
        for table in tables:
            writer.write_table(table)


def write_csv(path: Path, tables: Iterable[pa.Table]) -> None:
    """Replace a file by a table as CSV in UTF-8, part by part, whole or not at all: a line of names, cells that are
    empty where they are null, numbers as short as they read back the same. What would be a formula is written as
    as_cell does.

    Args:
        path: the file.
        tables: with the same columns, one at least.

    Raises:
        OSError: the file cannot be written; the message names it.
    """
    import pyarrow.csv

    csv: Any = pyarrow.csv  # whose stubs do not know its writer
    parts = map(_as_cells, tables)
    first = next(parts)
    options = csv.WriteOptions(quoting_style="needed")
    with writing(path) as file, csv.CSVWriter(file, first.schema, write_options=options) as writer:
        for table in chain([first], parts):
            writer.write_table(table)


def _as_cells(table: pa.Table) -> pa.Table:
    """With names as cells, and texts in place of their numbers."""
    import pyarrow as pa

    table = table.rename_columns([as_cell(name) for name in table.column_names]).combine_chunks()
    for n, field in enumerate(table.schema):
        if pa.types.is_dictionary(field.type):
            (column,) = table[n].chunks or [pa.array([], field.type)]
            texts = pa.array([as_cell(text) for text in column.dictionary.to_pylist()], pa.string())
            table = table.set_column(n, field.name, texts.take(column.indices))
    return table


def as_cell(name: str) -> str:
    """A name as a cell: an apostrophe precedes what would be a formula, or looks like a name that has one."""
    return f"'{name}" if _FORMULA.match(name) else name


def name_in_cell(cell: str) -> str:
    """The name that as_cell wrote."""
    return cell[1:] if cell.startswith("'") and _FORMULA.match(cell) else cell


def one_line(text: str) -> str:
    """A text with blanks for tabs, line breaks and other control characters, and none at its ends."""
    return _CONTROLS.sub(" ", text).strip()


def symmetric(column: Callable[[str], np.ndarray]) -> Float[np.ndarray, "*points 3 3"]:
    """The covariances from their columns, each of the shape of the points."""
    entries = {entry: column(name) for name, entry in COVARIANCE_COLUMNS.items()}
    return np.stack([np.stack([entries[min(i, j), max(i, j)] for j in range(3)], axis=-1) for i in range(3)], axis=-2)
