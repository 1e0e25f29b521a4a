"""Processor time of calls in the processes of a program, without a change of it."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

_FOLDER = "FGPOSE_BENCHMARK_TIMES"


def environment(module: str, folder: Path) -> dict[str, str]:
    """For a process; it and those that it starts call install() of a module of this folder first, which writes into the
    folder that is given (see folder_of_times)."""
    (folder / "sitecustomize.py").write_text(f"import {module}; {module}.install()\n")
    path = os.pathsep.join([str(folder), str(Path(__file__).parent), *filter(None, sys.path)])
    return os.environ | {"PYTHONPATH": path, _FOLDER: str(folder)}


def folder_of_times() -> Path:
    """Where a process writes that was started so."""
    return Path(os.environ[_FOLDER])


def timed(call: Callable[..., Any], what: str, seconds: dict[str, float]) -> Callable[..., Any]:
    """The same call, whose processor time is added to that of what it is."""
    lock = threading.Lock()

    def of_thread(*arguments: Any, **named: Any) -> Any:
        begin_s = time.thread_time()  # while a pipe is waited for it stands
        try:
            return call(*arguments, **named)
        finally:
            with lock:
                seconds[what] += time.thread_time() - begin_s

    return of_thread
