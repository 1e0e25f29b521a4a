"""What the commands print on: text as it is, tables, and bars of progress; lines in place of bars where they would not
be seen."""

from __future__ import annotations

import re
import shutil
import textwrap
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
from datetime import timedelta
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

# Between two lines in place of a bar. Who looks into a log knows within it whether the command is at work.
_LINE_EVERY_S = 30.0


def printable(text: str) -> str:
    """The text with characters that a terminal would obey as escapes, as ``\\x1b``."""
    return _COMMANDS.sub(lambda match: ascii(match[0])[1:-1], text)


def as_wide_as_the_terminal(text: str) -> str:
    """With line breaks between words, where a terminal would break lines inside of them."""
    width = shutil.get_terminal_size().columns
    lines = [
        textwrap.wrap(line, width, break_long_words=False, break_on_hyphens=False)
        if len(line) > width and "\x1b" not in line
        else [line]
        for line in text.split("\n")
    ]
    return "\n".join("\n".join(parts) for parts in lines)


class PlainConsole(Console):
    """Of stdout, of stderr, or of a file as rich.console.Console takes it."""

    def __init__(self, **options: Any) -> None:
        super().__init__(highlight=False, markup=False, **options)

    def render_str(self, text: str, **options: Any) -> Text:
        """Also what cells of tables hold goes through this."""
        return super().render_str(printable(text), **options)

    def status(self, status: RenderableType, **options: Any) -> Status:
        """A line with a spinner; where it could not turn a line now and then, unless the text is empty until it is
        updated. Rich takes its text for markup even where the console has none."""
        return _PlainStatus(status, console=self, **options)

    def on_broken_pipe(self) -> None:
        """Raises the error, which main takes for an exit code: Rich would end the program with another."""
        self.quiet = True
        raise

    @property
    def moves(self) -> bool:
        """Whether what is drawn can be drawn over."""
        return self.is_terminal and not self.is_dumb_terminal


class _PlainStatus(Status):
    def __init__(self, status: RenderableType, *, console: PlainConsole, **options: Any) -> None:
        super().__init__(_plain(status), console=console, **options)
        self._lines = None if console.moves or not status else ProgressLines(console, str(status))

    def start(self) -> None:
        super().start()
        if self._lines is not None:
            self._lines.start()

    def update(self, status: RenderableType | None = None, **options: Any) -> None:
        super().update(None if status is None else _plain(status), **options)
        if self._lines is not None and status is not None:
            self._lines.task = str(status)

    def stop(self) -> None:
        super().stop()
        if self._lines is not None:
            self._lines.stop()


def _plain(text: RenderableType) -> RenderableType:
    return Text(printable(text)) if isinstance(text, str) else text


class ProgressLines:
    """In place of what cannot move: a line every half minute; where something is counted (has a unit) also one at the
    beginning and one at the end, unless it is quiet, and ends before the first half minute. They come from a thread:
    what is waited for may be one long step."""

    def __init__(self, console: Console, task: str, unit: str = "", *, quiet: bool = False) -> None:
        self.task = task
        self._quiet = quiet
        self._console, self._unit = console, unit
        self._begin_s = time.monotonic()
        self._first: tuple[int, float] | None = None
        self._now: tuple[int, int, float] | None = None
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._go_on, name="fgpose-lines", daemon=True)

    def start(self) -> None:
        if self._unit and not self._quiet:
            self._print(self.task)
        self._thread.start()

    def told(self, done: int, total: int) -> None:
        """So many of so many are done."""
        now_s = time.monotonic()
        self._first = self._first or (done, now_s)
        self._now = done, total, now_s

    def stop(self) -> None:
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join()
        if self._now is not None and not self._quiet:
            self._print(self._line("in "))

    def __enter__(self) -> ProgressLines:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def _go_on(self) -> None:
        while not self._ended.wait(_LINE_EVERY_S):
            self._quiet = False
            self._print(self._line("after "))

    def _line(self, word: str) -> str:
        taken = f"{word}{_duration(time.monotonic() - self._begin_s)}"
        if self._now is None or self._first is None:
            return f"{self.task}: {taken}"
        done, total, now_s = self._now
        share = f" ({100 * done / total:.0f} %)" if total else ""
        first, first_s = self._first
        # What a run that did not end had done is done at the first report, in no time.
        left_s = (total - done) * (now_s - first_s) / (done - first) if first < done < total else None
        left = "" if left_s is None else f", {_duration(left_s)} left"
        return f"{self.task}: {done} of {total} {self._unit}{share} {taken}{left}"

    def _print(self, line: str) -> None:
        # Nobody may read them any more: the work goes on.
        with suppress(OSError, ValueError):
            self._console.print(line, soft_wrap=True)


def _duration(seconds: float) -> str:
    return str(timedelta(seconds=round(seconds)))


def new_console(*, stderr: bool = False) -> PlainConsole:
    """A console that prints text as it is: file names in brackets are no markup."""
    return PlainConsole(stderr=stderr)


def quiet_progress(task: str) -> AbstractContextManager[Callable[[int, int], None]]:
    """Of what is usually done in seconds: nothing is left of it on a terminal, and elsewhere nothing is printed unless
    it takes longer."""
    return progress_bar(task, "steps", quiet=True)


@contextmanager
def progress_bar(task: str, unit: str = "frames", *, quiet: bool = False) -> Iterator[Callable[[int, int], None]]:
    """A progress bar on stderr, so that what is printed can be piped; lines now and then where it cannot move."""
    console = new_console(stderr=True)
    if not console.moves:
        with ProgressLines(console, task, unit, quiet=quiet) as lines:
            yield lines.told
        return
    columns = (
        TextColumn("{task.description:<18}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn(unit),
        TimeRemainingColumn(elapsed_when_finished=True),
    )
    # A window of the smoother may take longer than the half minute from which the time left is estimated by default.
    with Progress(*columns, console=console, speed_estimate_period=600.0, transient=quiet) as bar:
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


def new_table(*headings: str, rows: Mapping[str, Iterable[str]] | None = None) -> Table:
    """A table of text in the first column and numbers in the others: empty, or with these rows by their first cells."""
    table = Table(box=box.SIMPLE_HEAD)
    table.add_column(headings[0])
    for heading in headings[1:]:
        table.add_column(heading, justify="right")
    for label, cells in (rows or {}).items():
        table.add_row(label, *cells)
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
