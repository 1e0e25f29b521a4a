"""Threads that give way, and only these."""

from __future__ import annotations

import os
import sys
import threading
import time
from pathlib import Path

import pytest

from fgpose.child_process import ChildProcess
from fgpose.live.processes.priority import give_way, threads_give_way

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="elsewhere priorities are those of processes")


def own() -> tuple[int, int]:
    """How this thread is scheduled."""
    return os.sched_getscheduler(0), os.getpriority(os.PRIO_PROCESS, threading.get_native_id())


def in_a_thread(nice: int) -> tuple[int, int]:
    found: list[tuple[int, int]] = []

    def work() -> None:
        give_way(nice)
        found.append(own())

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    return found[0]


def test_a_thread_gives_way_and_the_others_do_not() -> None:
    before = own()
    assert in_a_thread(before[1] + 1) == (os.SCHED_OTHER, before[1] + 1)
    assert in_a_thread(-20) == (os.SCHED_OTHER, before[1])  # it never asks for more than it has
    with threads_give_way():
        assert own()[0] == os.SCHED_OTHER
    assert own() == before


def test_a_process_gives_way_to_those_of_other_sessions() -> None:
    if not Path("/proc/self/autogroup").exists():
        pytest.skip("this Linux does not share the processor among sessions")
    before = Path("/proc/self/autogroup").read_text()
    process = ChildProcess("fgpose.live.diagnosis.diagnosis_process")
    of_session = Path(f"/proc/{process.process_id}/autogroup")
    try:
        end_s = time.monotonic() + 60
        while not (said := of_session.read_text()).endswith("nice 19\n"):
            assert time.monotonic() < end_s, said
            time.sleep(0.05)
    finally:
        process.close()
    assert Path("/proc/self/autogroup").read_text() == before
