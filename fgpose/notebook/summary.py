"""What is said of a thing in a few lines, or with a table and a picture."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

_LINE = 110
_MOST_LINES = 3
_MOST_NAMES = 6


@dataclass(frozen=True)
class Summary:
    """Of a thing that shows itself."""

    title: str
    facts: Mapping[str, str]
    """What is known of it, by a word or two; by none, what needs no word."""
    columns: tuple[str, ...] = ()
    """Of a table, with more than fits into lines."""
    rows: Sequence[tuple[str, ...]] = field(default=())
    picture: Callable[[], str] | None = None
    """SVG, drawn where it is shown: texts have none."""

    def text(self) -> str:
        """The title, and what is known in one line or two."""
        known = "; ".join(f"{name} {fact}".strip() for name, fact in self.facts.items())
        lines = textwrap.wrap(known, _LINE, max_lines=_MOST_LINES - 1, placeholder=" ...", break_long_words=False)
        return "\n".join([self.title, *(f"  {line}" for line in lines)])


def listed(names: Sequence[str]) -> str:
    """Names, not too many."""
    shown = ", ".join(names[:_MOST_NAMES])
    return f"{shown} and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else shown


def counted(number: int, what: str) -> str:
    """1 camera, 4 cameras, 1,200 frames."""
    return f"{number:,} {what}" + ("" if number == 1 else "s")


def percent(share: float) -> str:
    """Whole percents, but never 0 or 100 of what is not quite that."""
    if 0 < share < 0.005:
        return "< 1 %"
    if 0.995 <= share < 1:
        return "> 99 %"
    return f"{100 * share:.0f} %"
