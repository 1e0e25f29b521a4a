"""All that an object knows, to be compared."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np


def state_of(thing: object, seen: frozenset[int] = frozenset()) -> Any:
    """Everything that can be reached from an object of fgpose, as values that can be compared; of other libraries'
    objects nothing but their kind."""
    if id(thing) in seen:
        return "above"
    seen |= {id(thing)}
    if isinstance(thing, np.ndarray):
        return thing.shape, thing.tobytes()
    if isinstance(thing, Mapping):
        return [(state_of(key), state_of(value, seen)) for key, value in thing.items()]
    if isinstance(thing, list | tuple | deque | set):
        return [state_of(each, seen) for each in thing]
    if type(thing).__module__.startswith("fgpose") and hasattr(thing, "__dict__"):
        # What is computed once and kept is not a change.
        cached = {
            name for kind in type(thing).__mro__ for name, value in vars(kind).items() if hasattr(value, "attrname")
        }
        return [(name, state_of(value, seen)) for name, value in vars(thing).items() if name not in cached]
    return repr(thing) if isinstance(thing, int | float | str | bool | None) else type(thing).__name__
