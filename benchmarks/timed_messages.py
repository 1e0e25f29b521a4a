"""Processor time that the messages between the processes of a program take, beside that of the processes.

Whatever Python starts with ``environment`` has its messages timed (fgpose.child_process: pickling, and writing to and
reading from pipes), and the conversion of pictures to RGB, which is the only time that their pixels are copied.
"""

from __future__ import annotations

import atexit
import json
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import timed_calls
from timed_calls import timed

_SECONDS = {"messages": 0.0, "pictures": 0.0}


def environment(folder: Path) -> dict[str, str]:
    """For a process; it and those that it starts write their times into the folder when they end."""
    return timed_calls.environment("timed_messages", folder)


def table(folder: Path) -> str:
    """Of all processes that were started with the environment of this folder and have ended."""
    times = [json.loads(path.read_text()) for path in sorted(folder.glob("times_*.json"))]
    total = {name: sum(each[name] for each in times) for name in times[0]}
    rows = [f"| processor time of {len(times)} processes | s | share |", "|---|---:|---:|"]
    return "\n".join([*rows, *(f"| {name} | {s:.2f} | {s / total['all']:.2%} |" for name, s in total.items())])


def install() -> None:
    """In a process: from now on time the messages, and write the sums when it ends."""
    from fgpose import child_process
    from fgpose.live.sources.decoded import DecodedPicture

    def kept() -> None:
        times = {"all": time.process_time(), **_SECONDS}
        (timed_calls.folder_of_times() / f"times_{os.getpid()}.json").write_text(json.dumps(times))

    parent = child_process.parent

    @contextmanager
    def timed_parent() -> Iterator[tuple[Callable[[], Any], Callable[[object], None]]]:
        with parent() as (receive, send):
            yield timed(receive, "messages", _SECONDS), timed(send, "messages", _SECONDS)

    child_process.parent = timed_parent
    for name in ("write", "read"):
        method = getattr(child_process.ChildProcess, name)
        setattr(child_process.ChildProcess, name, timed(method, "messages", _SECONDS))
    DecodedPicture.rgb = timed(DecodedPicture.rgb, "pictures", _SECONDS)
    atexit.register(kept)
