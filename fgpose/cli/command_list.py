"""All commands by what they are for, a line each: what fgpose --help prints."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from fgpose.cli.console import new_console

# Wider, and the eye does not find the line of a name.
_WIDEST = 100


def print_commands(groups: Mapping[str, Mapping[str, type]], description: str) -> None:
    """Print the usage, what the program is, and a box for each group, as tyro prints the options of a command.

    Args:
        groups: the commands of each group by their names; the first line of a docstring says what one is for.
        description: what the program is, in paragraphs; lines are broken as wide as the console is.
    """
    console = new_console()
    console.width = min(console.width, _WIDEST)
    paragraphs = (" ".join(paragraph.split()) for paragraph in description.split("\n\n"))
    console.print("\n\n".join(("usage: fgpose COMMAND [OPTIONS]", *paragraphs)) + "\n")
    name_width = max(len(name) for group in groups.values() for name in group)
    for title, commands in groups.items():
        rows = Table.grid(padding=(0, 2))
        rows.add_column(min_width=name_width, no_wrap=True)
        # What another package says may be longer than a line.
        rows.add_column(no_wrap=True, overflow="ellipsis")
        for name, about in _lines(commands):
            rows.add_row(Text(name, style="bold"), about)
        console.print(Panel(rows, title=Text(title), title_align="left", border_style="dim"))
    console.print("fgpose COMMAND --help says all about a command.")


def _lines(commands: Mapping[str, type]) -> Iterator[tuple[str, str]]:
    for name, command in commands.items():
        yield name, (command.__doc__ or "").strip().partition("\n")[0].removesuffix(".")
