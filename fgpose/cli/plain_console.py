"""A console that prints text as it is: names in brackets are no markup, and names with escapes no commands."""

from __future__ import annotations

from typing import Any

from rich.console import Console, RenderableType
from rich.status import Status
from rich.text import Text

from fgpose.cli.printable import printable


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
