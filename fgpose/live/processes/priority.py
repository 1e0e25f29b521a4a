"""Which threads give way to others."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

_OF_SESSION = Path("/proc/self/autogroup")


def give_way(nice: int) -> None:
    """Let this thread have what is left by others, also where all is started as a real-time program (``chrt``)."""
    if sys.platform == "linux":  # elsewhere priorities are those of whole processes
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        thread = threading.get_native_id()
        # Whoever started it with less priority may not take it back.
        os.setpriority(os.PRIO_PROCESS, thread, max(nice, os.getpriority(os.PRIO_PROCESS, thread)))


def session_gives_way(nice: int) -> None:
    """Let this process, which has a session of its own, have what is left by others. Among sessions Linux shares the
    processor evenly, whatever the priorities in them, unless it is told not to (man 7 sched, autogroup)."""
    give_way(nice)
    if sys.platform == "linux" and os.getsid(0) == os.getpid():
        with suppress(OSError):  # it does not share the processor among sessions
            _OF_SESSION.write_text(str(nice))


@contextmanager
def threads_give_way() -> Iterator[None]:
    """Threads that a library starts meanwhile are no real-time threads, whatever this one is."""
    if sys.platform != "linux":
        yield
        return
    policy, parameter = os.sched_getscheduler(0), os.sched_getparam(0)
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    try:
        yield
    finally:
        os.sched_setscheduler(0, policy, parameter)
