"""What other packages add to fgpose, by the entry points of their distributions (docs/extending.md)."""

from __future__ import annotations

import warnings
from functools import cache
from importlib.metadata import entry_points
from typing import Any, Literal

Group = Literal["fgpose.commands", "fgpose.demonstrations", "fgpose.detectors", "fgpose.formats"]


@cache  # to look takes milliseconds, and every reader of a file asks
def added(group: Group) -> dict[str, Any]:
    """What others add to a group, by its name; imported.

    Warns:
        UserWarning: something cannot be imported; it is left out.
    """
    found = {}
    for entry in sorted(entry_points(group=group), key=lambda entry: entry.name):
        try:
            found[entry.name] = entry.load()
        except Exception as error:
            whose = entry.dist.name if entry.dist else entry.value
            warnings.warn(f"{entry.name} of {whose} cannot be loaded: {error}", stacklevel=2)
    return found
