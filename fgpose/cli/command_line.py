"""The command line that is at work."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from contextvars import ContextVar

_ARGUMENTS: ContextVar[tuple[str, ...]] = ContextVar("arguments", default=())


def set_arguments(arguments: Sequence[str]) -> None:
    """Remember what main was called with, for the results that are made."""
    _ARGUMENTS.set(tuple(arguments))


def command_line() -> str:
    """As it can be typed into a shell."""
    return shlex.join(["fgpose", *_ARGUMENTS.get()])
