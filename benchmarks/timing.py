"""Wall and processor time of a call, and the memory of this process."""

from __future__ import annotations

import gc
import resource
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

Result = TypeVar("Result")

_KIB_PER_MB = 1e6 / 1024
_PAGE_MB = resource.getpagesize() / 1e6


@dataclass(frozen=True)
class Timing:
    wall_s: float
    cpu_s: float
    """Of all threads of the process."""


def timed(call: Callable[[], Result], *, collect: bool = True) -> tuple[Timing, Result]:
    """How long a call takes, and what it returns.

    Args:
        call: what is timed.
        collect: collect garbage first, so that what earlier calls left is not collected in this one.
    """
    if collect:
        gc.collect()
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    result = call()
    return Timing(time.perf_counter() - wall_s, time.process_time() - cpu_s), result


def peak_memory_mb() -> float:
    """Largest resident memory that this process has had, megabytes (Linux: ru_maxrss counts KiB)."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / _KIB_PER_MB


def resident_memory_mb() -> float:
    """Resident memory of this process now, megabytes (Linux)."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * _PAGE_MB
