"""``{command-help} smooth``: what ``fgpose smooth --help`` prints."""

from __future__ import annotations

import contextlib
import io
import os
from typing import TYPE_CHECKING, Any
from unittest import mock

from docutils import nodes
from sphinx.util.docutils import SphinxDirective

from fgpose.cli import main

if TYPE_CHECKING:
    from sphinx.application import Sphinx

# As wide as the text of a page is in the type of code.
_COLUMNS = "78"


def help_of(command: str) -> str:
    """The help of a command, or of the program."""
    printed = io.StringIO()
    # The build's own options must not colour the text, nor its terminal decide how wide it is.
    environment = {"COLUMNS": _COLUMNS, "NO_COLOR": "1", "TERM": "dumb"}
    with (
        mock.patch.dict(os.environ, environment),
        contextlib.redirect_stdout(printed),
        contextlib.suppress(SystemExit),
    ):
        main([*command.split(), "--help"])
    return "\n".join(line.rstrip() for line in printed.getvalue().splitlines())


class CommandHelp(SphinxDirective):
    """Its argument is the command; none stands for the program."""

    optional_arguments = 1
    final_argument_whitespace = True

    def run(self) -> list[nodes.Node]:
        self.env.note_reread()  # the help may change with any file of the program
        text = help_of(self.arguments[0] if self.arguments else "")
        block = nodes.literal_block(text, text, language="text", classes=["help"])
        self.set_source_info(block)
        return [block]


def setup(app: Sphinx) -> dict[str, Any]:
    app.add_directive("command-help", CommandHelp)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
