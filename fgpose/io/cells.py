"""Names as cells of tables, which other programs open: none is a formula, and none more than one cell."""

from __future__ import annotations

import re

from fgpose.skeleton import CONTROL

# A table program runs a cell that begins so, which could send the table elsewhere.
_FORMULA = re.compile(r"'*[=+\-@\t\r\n]")
_CONTROLS = re.compile(f"{CONTROL.pattern}+")


def as_cell(name: str) -> str:
    """A name as a cell: an apostrophe precedes what would be a formula, or looks like a name that has one."""
    return f"'{name}" if _FORMULA.match(name) else name


def name_in_cell(cell: str) -> str:
    """The name that as_cell wrote."""
    return cell[1:] if cell.startswith("'") and _FORMULA.match(cell) else cell


def one_line(text: str) -> str:
    """A text with blanks for tabs, line breaks and other control characters, and none at its ends."""
    return _CONTROLS.sub(" ", text).strip()
