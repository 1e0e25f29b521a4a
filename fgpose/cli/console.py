"""What the commands print on: text as it is, tables, and bars of progress."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.console import Console, RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.status import Status
from rich.table import Table
from rich.text import Text

# Control characters but newline and tab, marks that turn the direction of writing, and bytes that are no text. A
# terminal takes some of them for commands: they could change what was printed before, or what is pasted next.
_COMMANDS = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")


def printable(text: str) -> str:
    """The text with characters that a terminal would obey as escapes, as ``\\x1b``."""
    return _COMMANDS.sub(lambda match: ascii(match[0])[1:-1], text)


class PlainConsole(Console):
    """Of stdout, of stderr, or of a file as rich.console.Console takes it."""

    def __init__(self, **options: Any) -> None:
        super().__init__(highlight=False, markup=False, **options)

    def render_str(self, text: str, **options: Any) -> Text:
        """Also what cells of tables hold goes through this."""
        return super().render_str(printable(text), **options)

    def status(self, status: RenderableType, **options: Any) -> Status:
        """A line with a spinner. Rich takes its text for markup even where the console has none."""
        return _PlainStatus(status, console=self, **options)


class _PlainStatus(Status):
    def __init__(self, status: RenderableType, **options: Any) -> None:
        super().__init__(_plain(status), **options)

    def update(self, status: RenderableType | None = None, **options: Any) -> None:
        super().update(None if status is None else _plain(status), **options)


def _plain(text: RenderableType) -> RenderableType:
    return Text(printable(text)) if isinstance(text, str) else text


def new_console(*, stderr: bool = False) -> Console:
    """A console that prints text as it is: file names in brackets are no markup."""
    return PlainConsole(stderr=stderr)


@contextmanager
def progress_bar(task: str, unit: str = "frames") -> Iterator[Callable[[int, int], None]]:
    """A progress bar on stderr, so that what is printed can be piped."""
    columns = (
        TextColumn("{task.description:<18}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn(unit),
        TimeRemainingColumn(elapsed_when_finished=True),
    )
    # A window of the smoother may take longer than the half minute from which the time left is estimated by default.
    with Progress(*columns, console=new_console(stderr=True), speed_estimate_period=600.0) as bar:
        number = bar.add_task(task, total=None)
        yield lambda done, total: bar.update(number, completed=done, total=total)


@contextmanager
def counting_bar(task: str, unit: str, total: int) -> Iterator[Callable[[object], None]]:
    """A progress bar that is one further at each call, whatever it is called with."""
    done = 0
    with progress_bar(task, unit) as progress:

        def advance(_: object) -> None:
            nonlocal done
            done += 1
            progress(done, total)

        progress(0, total)
        yield advance


def new_table(*headings: str) -> Table:
    """An empty table: text in the first column, numbers in the others."""
    table = Table(box=box.SIMPLE_HEAD)
    table.add_column(headings[0])
    for heading in headings[1:]:
        table.add_column(heading, justify="right")
    return table


def number(value: float, form: str = "") -> str:
    """For a cell: by default with one digit behind the point, or none from 1000 on; a dash for NaN."""
    if np.isnan(value):
        return "-"
    return format(value, form or (".0f" if abs(value) >= 1000 else ".1f"))


def print_written(console: Console, *paths: Path) -> None:
    """Say which files there are now."""
    for path in paths:
        console.print(f"wrote {path}", soft_wrap=True)
