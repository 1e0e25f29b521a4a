"""What a page is made of: sections of tables, plots, pictures and sentences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np


@dataclass(frozen=True)
class TableCell:
    """A cell of a table."""

    text: str
    shade: float = 0.0
    """How strongly it is coloured, in [0, 1]: the worse the stronger."""
    key: float | str | None = None
    """What it is sorted by; by default the text."""
    href: str = ""
    svg: str = ""
    """A small picture instead of the text."""
    is_long: bool = False
    """Whether the text is sentences, of which the first lines are shown."""


@dataclass(frozen=True)
class Table:
    """A table with a heading for each column; those of numbers are set flush right."""

    kind: ClassVar[str] = "table"
    columns: tuple[str, ...]
    rows: tuple[tuple[TableCell, ...], ...]
    caption: str = ""
    numeric: tuple[bool, ...] = ()
    """Which columns are of numbers; by default all but the first."""
    hints: tuple[str, ...] = ()
    """What each heading means."""
    identifier: str = ""
    """Makes it sortable and filterable, if it has one."""
    sorted_by: int | None = None
    """Column by which the rows fall, if they are in the order of one."""

    @property
    def explained(self) -> list[tuple[str, str]]:
        """The headings that have a hint, and the hint."""
        return [(name, hint) for name, hint in zip(self.columns, self.hints, strict=False) if hint]

    def is_numeric(self, column: int) -> bool:
        return self.numeric[column] if self.numeric else column > 0

    def hint(self, column: int) -> str:
        return self.hints[column] if self.hints else ""


@dataclass(frozen=True, eq=False)
class Plot:
    """An interactive figure."""

    kind: ClassVar[str] = "plot"
    model: Any
    """Of Bokeh."""
    caption: str
    height_px: int
    half: bool = False
    """Whether it takes half the width of the page, beside the next one."""


@dataclass(frozen=True)
class Note:
    """A sentence; is_missing: on what could not be shown, and why."""

    kind: ClassVar[str] = "note"
    text: str
    is_missing: bool = False


@dataclass(frozen=True)
class JpegPicture:
    """A JPEG image."""

    source: str
    """data: address."""
    caption: str
    alt: str = ""
    """What is seen on it, for those who do not see it."""


@dataclass(frozen=True)
class PicturedMoment:
    """A moment with its pictures."""

    kind: ClassVar[str] = "moment"
    title: str
    reason: str
    pictures: tuple[JpegPicture, ...] = ()


@dataclass(frozen=True)
class Text:
    """Lines of a file, folded."""

    kind: ClassVar[str] = "text"
    title: str
    text: str


@dataclass(frozen=True)
class OfPerson:
    """What is shown of one of several people, while that person is chosen."""

    kind: ClassVar[str] = "person"
    person: str
    """How they are called."""
    blocks: tuple[Block, ...]
    is_chosen: bool = False
    """Whether they are the one who is shown first."""


@dataclass(frozen=True)
class Folded:
    """What is not shown until it is asked for."""

    kind: ClassVar[str] = "folded"
    title: str
    """What it is and, in the same line, what it says."""
    blocks: tuple[Block, ...]


Block = Table | Plot | Note | PicturedMoment | Text | OfPerson | Folded


@dataclass(frozen=True)
class Section:
    """A part of a page."""

    title: str
    anchor: str
    blocks: Sequence[Block] = field(default_factory=tuple)
    intro: str = ""
    short: str = ""
    """The title in the list of sections, if it is too long for that."""

    @property
    def plots(self) -> list[Plot]:
        """In their order, those of people and those that are folded included."""
        return _plots_in(self.blocks)


def _plots_in(blocks: Sequence[Block]) -> list[Plot]:
    found: list[Plot] = []
    for block in blocks:
        if isinstance(block, Plot):
            found.append(block)
        elif isinstance(block, OfPerson | Folded):
            found += _plots_in(block.blocks)
    return found


def number(value: float | int | None, digits: int = 1, unit: str = "", *, worst: float = np.nan) -> TableCell:
    """A number with its unit, as a cell; a dash where it is not known.

    Args:
        worst: the value at which the cell is fully coloured; half of it is not coloured at all.
    """
    if value is None or not np.isfinite(value):
        return TableCell("–", key=float("-inf"))
    shade = float(np.clip(2 * value / worst - 1, 0, 1)) if np.isfinite(worst) and worst > 0 else 0.0
    text = f"{value:.{digits}f}{unit}"
    return TableCell(text.removeprefix("-") if float(f"{value:.{digits}f}") == 0 else text, shade, float(value))


def percent(share: float, digits: int = 0, *, bad_below: float = np.nan) -> TableCell:
    """A share, as a cell: coloured below a limit, the stronger the further it is from it."""
    if not np.isfinite(share):
        return TableCell("–", key=float("-inf"))
    shade = float(np.clip((bad_below - share) / bad_below, 0, 1)) if np.isfinite(bad_below) else 0.0
    return TableCell(f"{100 * share:.{digits}f} %", shade, float(share))
