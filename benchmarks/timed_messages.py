"""Processor time that the messages between the processes of a program take, beside that of the processes.

Whatever Python starts with ``environment`` has its messages timed (fgpose.child_process: pickling, and writing to and
reading from pipes), and the conversion of pictures to RGB, which is the only time that their pixels are copied.
"""

from __future__ import annotations

import atexit
import json
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

_FOLDER = "FGPOSE_BENCHMARK_TIMES"
_SECONDS = {"messages": 0.0, "pictures": 0.0}


def environment(folder: Path) -> dict[str, str]:
    """For a process; it and those that it starts write their times into the folder when they end."""
    (folder / "sitecustomize.py").write_text("import timed_messages; timed_messages.install()\n")
    path = os.pathsep.join([str(folder), str(Path(__file__).parent), *filter(None, sys.path)])
    return os.environ | {"PYTHONPATH": path, _FOLDER: str(folder)}


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
        (Path(os.environ[_FOLDER]) / f"times_{os.getpid()}.json").write_text(json.dumps(times))

    parent = child_process.parent

    @contextmanager
    def timed_parent() -> Iterator[tuple[Callable[[], Any], Callable[[object], None]]]:
        with parent() as (receive, send):
            yield _timed(receive, "messages"), _timed(send, "messages")

    child_process.parent = timed_parent
    for name in ("write", "read"):
        method = getattr(child_process.ChildProcess, name)
        setattr(child_process.ChildProcess, name, _timed(method, "messages"))
    DecodedPicture.rgb = _timed(DecodedPicture.rgb, "pictures")
    atexit.register(kept)


def _timed(call: Callable[..., Any], what: str) -> Callable[..., Any]:
    lock = threading.Lock()

    def timed(*arguments: Any, **named: Any) -> Any:
        begin_s = time.thread_time()  # while a pipe is waited for it stands
        try:
            return call(*arguments, **named)
        finally:
            with lock:
                _SECONDS[what] += time.thread_time() - begin_s

    return timed
