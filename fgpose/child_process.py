"""A part of this program in a process of its own. Both sides exchange pickles, each after its length.

Python keeps to one core whatever the number of threads, and what a library does to its process it does to all of it.
The child is started as a command and not by multiprocessing, which would run the user's script again.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import pickle
import select
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

_ENDS_WITHIN_S = 5.0
_LENGTH = struct.Struct("<Q")
# Whether a process is stopped is looked at so often while it is waited for.
_LOOKS_S = 0.1
_READ_BYTES = 1 << 20
# Runs a program in a group of its own, and ends the group when the standard input does.
_GUARD = """
import os, signal, subprocess, sys, threading
program = subprocess.Popen(sys.argv[1:], stdin=subprocess.DEVNULL, start_new_session=True)
def end():
    while os.read(0, 1):
        pass
    for number in (signal.SIGTERM, signal.SIGKILL):
        try:
            os.killpg(program.pid, number)
            program.wait(3)
        except (ProcessLookupError, subprocess.TimeoutExpired):
            pass
threading.Thread(target=end, daemon=True).start()
code = program.wait()
os._exit(code if code >= 0 else 128 - code)
"""


class ChildProcess:
    """A process that calls a function of a module, which exchanges messages with this one by parent().

    It should end when its messages do, as it does when it is closed, or when this process ends however that happens.

    Args:
        module: to import.
        function: to call in it, without arguments.

    Raises:
        OSError: it cannot be started.
    """

    def __init__(self, module: str, function: str = "serve") -> None:
        self._process = subprocess.Popen(
            # -P: the folder where the user is may have modules whose names are those of others.
            [sys.executable, "-P", "-c", f"from {module} import {function}; {function}()"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            bufsize=0,
            # Modules are found where this process finds them.
            env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
            # Ctrl-C is for this process, which may still want answers.
            start_new_session=True,
        )
        for pipe in (self._stdin, self._stdout):
            os.set_blocking(pipe.fileno(), False)

    @property
    def process_id(self) -> int:
        return self._process.pid

    @property
    def status(self) -> int | None:
        """With which it ended; None: it runs."""
        return self._process.poll()

    @property
    def is_stopped(self) -> bool:
        """See is_stopped."""
        return is_stopped(self.process_id)

    def write(self, message: object, timeout_s: float = math.inf) -> None:
        """Raises BrokenPipeError if the process has ended or is closed, TimeoutError if it does not take the message in
        time or is stopped; after that it can only be ended. Time that the computer does not give it does not count.
        Without a limit it may be stopped as long as it likes."""
        deadline = _Deadline(timeout_s, self.process_id)
        body = pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL)
        left = memoryview(_LENGTH.pack(len(body)) + body)
        try:
            while left:
                self._wait(self._stdin, select.POLLOUT, deadline)
                left = left[self._stdin.write(left) or 0 :]
        # Another thread has closed it.
        except ValueError:
            raise BrokenPipeError("the process is closed") from None

    def read(self, timeout_s: float = math.inf) -> Any:
        """The next message. Raises EOFError if the process has ended or is closed, TimeoutError as write."""
        deadline = _Deadline(timeout_s, self.process_id)
        try:
            (length,) = _LENGTH.unpack(self._read(_LENGTH.size, deadline))
            body = self._read(length, deadline)
        # Another thread has closed it.
        except ValueError:
            raise EOFError("the process is closed") from None
        return pickle.loads(body)

    def has_message(self) -> bool:
        """Whether a message has begun to come, or the process has ended."""
        return _is_ready(self._stdout, select.POLLIN, 0.0)

    def kill(self) -> None:
        """End it at once."""
        self._process.kill()

    def close(self) -> None:
        """End its messages, wait until it has ended, and kill it if that takes long. Closing again does nothing."""
        with suppress(BrokenPipeError):
            self._stdin.close()
        if self.is_stopped:
            self._process.kill()
        try:
            self._process.wait(_ENDS_WITHIN_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._stdout.close()

    @property
    def _stdin(self) -> IO[bytes]:
        assert self._process.stdin is not None
        return self._process.stdin

    @property
    def _stdout(self) -> IO[bytes]:
        assert self._process.stdout is not None
        return self._process.stdout

    def _read(self, n_bytes: int, deadline: _Deadline) -> bytes:
        body = bytearray()
        while len(body) < n_bytes:
            self._wait(self._stdout, select.POLLIN, deadline)
            some = self._stdout.read(min(n_bytes - len(body), _READ_BYTES))
            if some == b"":
                raise EOFError("the process has ended")
            body += some or b""
        return bytes(body)

    def _wait(self, pipe: IO[bytes], event: int, deadline: _Deadline) -> None:
        """Until a pipe can be read or written. Raises TimeoutError."""
        looks = StoppedTwice()
        while not _is_ready(pipe, event, min(max(deadline.left_s, 0.0), _LOOKS_S)):
            is_stopped = deadline.is_finite and self.is_stopped
            if looks.again(is_stopped) or deadline.left_s <= 0:
                raise TimeoutError(f"process {self.process_id} {'is stopped' if is_stopped else 'does not answer'}")


class _Deadline:
    """Until which a process has time, but for what the computer does not give it."""

    def __init__(self, timeout_s: float, process_id: int) -> None:
        self.is_finite, self._process_id = math.isfinite(timeout_s), process_id
        self._end_s = time.monotonic() + timeout_s - (waited_for_core_s(process_id) if self.is_finite else 0.0)

    @property
    def left_s(self) -> float:
        if not self.is_finite:
            return math.inf
        return self._end_s + waited_for_core_s(self._process_id) - time.monotonic()


class StoppedTwice:
    """Looks at whether a process is stopped. One is not enough: whoever stops it for a moment lets it go on at once."""

    def __init__(self) -> None:
        self._was_stopped = False

    def again(self, is_stopped: bool) -> bool:
        """Whether it is at this look and was at the one before."""
        was_stopped, self._was_stopped = self._was_stopped, is_stopped
        return is_stopped and was_stopped


def is_stopped(process_id: int) -> bool:
    """Whether a process has got SIGSTOP or is held by a debugger; seen on Linux only."""
    with suppress(OSError):
        after_name = Path(f"/proc/{process_id}/stat").read_text().rpartition(")")[2]
        return after_name.split()[0] in "Tt"
    return False


def waited_for_core_s(process_id: int) -> float:
    """How long the main thread of a process could have run so far but others did; 0 where the system does not tell."""
    with suppress(OSError, IndexError, ValueError):
        return 1e-9 * int(Path(f"/proc/{process_id}/schedstat").read_text().split()[1])
    return 0.0


def _is_ready(pipe: IO[bytes], event: int, timeout_s: float) -> bool:
    poll = select.poll()
    poll.register(pipe, event)
    return bool(poll.poll(1000 * timeout_s))


def run_program(command: Sequence[str]) -> int:
    """Run a program to its end, which is that of this process at the latest, however that comes. What it starts itself
    ends too.

    Returns:
        Its exit code.

    Raises:
        OSError: it cannot be started.
    """
    # Only this process has the other end of its input, so that it ends with it. Ctrl-C is for this process.
    guarded = [sys.executable, "-I", "-c", _GUARD, *command]
    with subprocess.Popen(guarded, stdin=subprocess.PIPE, start_new_session=True) as guard:
        return guard.wait()


def end_with_parent() -> None:
    """In a process of multiprocessing: end when the process that started it has ended, however that was."""

    def watch() -> None:
        parent_process = multiprocessing.parent_process()
        if parent_process is not None:
            parent_process.join()
            os._exit(1)

    threading.Thread(target=watch, name="fgpose watches its parent", daemon=True).start()


@contextmanager
def parent() -> Iterator[tuple[Callable[[], Any], Callable[[object], None]]]:
    """The other side, in the child: a function that gives the next message of the parent, which raises EOFError when
    there are no more; and one that sends it a message, from any thread. What is sent to a parent that has ended is lost
    without a word: receive tells."""
    lock = threading.Lock()
    with _forgiving(os.fdopen(os.dup(sys.stdout.fileno()), "wb")) as answers:
        sys.stdout = sys.stderr  # nothing else may get between the messages

        def read(n_bytes: int) -> bytes:
            body = sys.stdin.buffer.read(n_bytes)
            if len(body) < n_bytes:
                raise EOFError("there are no more messages")
            return body

        def receive() -> Any:
            return pickle.loads(read(*_LENGTH.unpack(read(_LENGTH.size))))

        def send(message: object) -> None:
            body = pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL)
            with lock, suppress(BrokenPipeError):
                answers.write(_LENGTH.pack(len(body)))
                answers.write(body)
                answers.flush()

        yield receive, send


@contextmanager
def _forgiving(pipe: IO[bytes]) -> Iterator[IO[bytes]]:
    """It is closed in the end. What could not be written because the parent has ended is tried again then: in vain."""
    try:
        yield pipe
    finally:
        with suppress(BrokenPipeError):
            pipe.close()


def n_cores() -> int:
    """Of this computer, those that this process and its children may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
