"""Tables of events: what happened when, in which recording."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from fgpose.io.content import read_content
from fgpose.plain_files import check_expansion, naming

_NAMES = ("subject", "session", "trial")
_MAX_BYTES = 100 << 20
_MAX_COLUMNS = 1000
_CELL_BYTES = 100


@dataclass(frozen=True)
class Event:
    """Something that happened in a recording, or in each of several."""

    name: str
    time_s: float
    """By the clock of the recording."""
    whose: Mapping[str, str]
    """Those of subject, session and trial that the table has."""
    others: Mapping[str, str] = field(default_factory=dict)
    """The other columns."""


def read_events(path: Path) -> tuple[Event, ...]:
    """The rows of a CSV or TSV file, whose first line names the columns: event, time_s, and some of subject, session,
    trial. Empty lines do not count.

    Raises:
        ValueError: a column is missing, a row is too short, or a time is no number; the message names file and line.
        OSError: the file cannot be read.
    """
    with naming(path, damage=[csv.Error]):
        text = read_content(path, _MAX_BYTES).decode("utf-8-sig")
        first = text.partition("\n")[0]
        delimiter = max("\t;,", key=first.count)
        n_columns = first.count(delimiter) + 1
        if n_columns > _MAX_COLUMNS:
            raise ValueError(f"its first line names {n_columns} columns, at most {_MAX_COLUMNS} are read")
        check_expansion(_CELL_BYTES * n_columns * text.count("\n"), len(text))  # for rows may be shorter than the first
        rows = csv.DictReader(io.StringIO(text), delimiter=delimiter)
        _check_columns(rows.fieldnames or ())
        return tuple(_event(row, rows.line_num) for row in rows)


def _check_columns(columns: object) -> None:
    names = tuple(columns) if isinstance(columns, list | tuple) else ()
    missing = [name for name in ("event", "time_s") if name not in names]
    if missing or not set(_NAMES) & set(names):
        needed = " and ".join(missing) or "subject, session or trial"
        raise ValueError(f"a table of events needs the column {needed}; its first line is {', '.join(map(str, names))}")


def _event(row: dict[str, str | None], line: int) -> Event:
    values = {name: (value or "").strip() for name, value in row.items() if isinstance(name, str)}
    try:
        time_s = float(values["time_s"])
    except ValueError:
        time_s = math.nan
    if not math.isfinite(time_s):
        raise ValueError(f"line {line}: time_s is {values['time_s']!r}, no number of seconds")
    whose = {name: values[name] for name in _NAMES if name in values}
    others = {name: value for name, value in values.items() if name not in (*_NAMES, "event", "time_s")}
    return Event(values["event"], time_s, whose, others)
