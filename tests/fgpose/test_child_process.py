"""A process of our own is never waited for longer than one wants."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import suppress

import numpy as np
import pytest

from fgpose import child_process
from fgpose.child_process import ChildProcess, parent

# A long time: nothing here waits for it unless something is wrong.
LONG_S = 120.0


def echo() -> None:
    """In the process: send back what comes."""
    with parent() as (receive, send):
        while True:
            try:
                send(receive())
            except EOFError:
                return


def answer_nobody() -> None:
    """In the process: send something when nothing more comes."""
    with parent() as (receive, send), suppress(EOFError):
        try:
            receive()
        finally:
            for message in ("unheard", b"more than a pipe holds" * 100_000):
                send(message)


@pytest.fixture
def process() -> Iterator[ChildProcess]:
    child = ChildProcess(__name__, "echo")
    yield child
    child.close()
    assert child.status is not None


def test_messages_of_any_size_come_back(process: ChildProcess) -> None:
    large = np.arange(1 << 19, dtype=float)  # many times what a pipe holds
    for message in ("hello", None, large):
        process.write(message, LONG_S)
        np.testing.assert_array_equal(process.read(LONG_S), message)
    assert not process.has_message()


def test_one_whose_parent_was_killed_ends_without_a_word(capfd: pytest.CaptureFixture[str]) -> None:
    child = ChildProcess(__name__, "answer_nobody")
    for pipe in (child._stdout, child._stdin):
        pipe.close()
    assert child._process.wait(LONG_S) == 0
    assert capfd.readouterr().err == ""


def test_one_that_is_stopped_or_silent_is_not_waited_for(process: ChildProcess) -> None:
    process.write(0)
    assert process.read(LONG_S) == 0
    with pytest.raises(TimeoutError, match="does not answer"):
        process.read(0.01)
    os.kill(process.process_id, signal.SIGSTOP)
    os.waitid(os.P_PID, process.process_id, os.WSTOPPED | os.WNOWAIT)
    with pytest.raises(TimeoutError, match="is stopped"):
        process.read(LONG_S)
    with pytest.raises(TimeoutError, match="is stopped"):
        process.write(np.zeros(1 << 19), LONG_S)
    process.close()
    assert process.status == -signal.SIGKILL


def test_what_the_computer_does_not_give_it_is_no_silence(
    process: ChildProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert child_process.waited_for_core_s(process.process_id) >= 0.0
    others_s = iter([0.0, *(LONG_S for _ in range(5))])
    monkeypatch.setattr(child_process, "waited_for_core_s", lambda process_id: next(others_s, 0.0))
    monkeypatch.setattr(child_process, "_LOOKS_S", 0.001)
    with pytest.raises(TimeoutError, match="does not answer"):
        process.read(0.0)
    assert next(others_s, None) is None


def test_one_that_has_ended_or_is_closed_says_so(process: ChildProcess) -> None:
    process.kill()
    with pytest.raises(EOFError):
        process.read()
    process._process.wait()  # a process that ends closes one stream after the other
    with pytest.raises(BrokenPipeError):
        process.write(0)
    process.close()
    with pytest.raises(EOFError):
        process.read()
    with pytest.raises(BrokenPipeError):
        process.write(0)
