"""``{columns} module.NAME``: the table of the columns, or arrays, that the code describes beside what writes them."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any

from docutils import nodes
from sphinx.util.docutils import SphinxDirective

from fgpose.io.tables import Column

if TYPE_CHECKING:
    from sphinx.application import Sphinx


def markdown(columns: Sequence[Column]) -> str:
    """The table; of arrays with their shapes."""
    are_arrays = any(column.shape for column in columns)
    head = ["array", "unit", "shape", "meaning"] if are_arrays else ["column", "unit", "meaning"]
    rows = [head, ["---"] * len(head)]
    for column in columns:
        names = ", ".join(f"`{name}`" for name in column.names.split())
        rows.append([names, column.unit, *([column.shape] if are_arrays else []), column.meaning])
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


class ColumnsDirective(SphinxDirective):
    """Takes where the columns are."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        module, _, name = self.arguments[0].rpartition(".")
        self.env.note_dependency(str(import_module(module).__file__))
        return self.parse_text_to_nodes(markdown(getattr(import_module(module), name)))


def setup(app: Sphinx) -> dict[str, Any]:
    app.add_directive("columns", ColumnsDirective)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
