"""Docstrings of fgpose are plain text with sections (Args, Returns, Raises).

What reStructuredText would take for markup is escaped, and a colon in the docstring of a field does not make the words
before it a type.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sphinx.application import Sphinx

_LITERAL = re.compile(r"(``.+?``|`[^`]+`)")
_MARKUP = re.compile(r"([*|@]|(?<=\w)_(?!\w))")
_FIELDS = {"attribute", "property"}
# Sphinx calls the listeners of an event in the order of these numbers; napoleon has 500.
_BEFORE_NAPOLEON, _AFTER_NAPOLEON = 400, 600


def escaped(line: str) -> str:
    """A line as reStructuredText that shows what the line says; code in one or two backticks is code."""
    parts = _LITERAL.split(line)
    for n, part in enumerate(parts):
        parts[n] = f"``{part.strip('`')}``" if n % 2 else _MARKUP.sub(r"\\\1", part)
    return "".join(parts)


def setup(app: Sphinx) -> dict[str, Any]:
    fields: dict[str, list[str]] = {}

    def before(_: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
        lines[:] = [escaped(line) for line in lines]
        if what in _FIELDS:
            fields[name] = list(lines)

    def after(_: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
        if what in _FIELDS:
            lines[:] = fields.pop(name)

    def signature(
        _: Sphinx, what: str, name: str, obj: object, options: object, arguments: str | None, returns: str | None
    ) -> tuple[str | None, str | None]:
        # What a dataclass shows for a default that is made anew is no Python, and spoils the rest of the signature.
        return arguments and arguments.replace("<factory>", "..."), returns

    app.connect("autodoc-process-signature", signature)
    app.connect("autodoc-process-docstring", before, priority=_BEFORE_NAPOLEON)
    app.connect("autodoc-process-docstring", after, priority=_AFTER_NAPOLEON)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
