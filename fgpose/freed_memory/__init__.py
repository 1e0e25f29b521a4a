"""Memory that is free within the process, handed back to the system."""

from __future__ import annotations

import ctypes
import sys
from contextlib import suppress


def hand_back() -> None:
    """Call it where much has just been freed and much will be taken.

    The C library keeps what it was given for small arrays, and takes more for larger ones: of a long recording, as much
    again as is needed; where it is not glibc, it goes on keeping it. Arrow keeps memory in a pool of its own.
    """
    if (arrow := sys.modules.get("pyarrow")) is not None:
        arrow.default_memory_pool().release_unused()
    with suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)
