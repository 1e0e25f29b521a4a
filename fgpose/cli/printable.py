"""What is printed of names and messages from files and from the network."""

from __future__ import annotations

import re

# Control characters but newline and tab, marks that turn the direction of writing, and bytes that are no text. A
# terminal takes some of them for commands: they could change what was printed before, or what is pasted next.
_COMMANDS = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")


def printable(text: str) -> str:
    """The text with characters that a terminal would obey as escapes, as ``\\x1b``."""
    return _COMMANDS.sub(lambda match: ascii(match[0])[1:-1], text)
