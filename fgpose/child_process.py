"""A part of this program in a process of its own. Both sides exchange pickles.

Python keeps to one core whatever the number of threads, and what a library does to its process it does to all of it.
The child is started as a command and not by multiprocessing, which would run the user's script again.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import select
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any

_ENDS_WITHIN_S = 5.0
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
            # Modules are found where this process finds them.
            env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
            # Ctrl-C is for this process, which may still want answers.
            start_new_session=True,
        )

    @property
    def process_id(self) -> int:
        return self._process.pid

    @property
    def status(self) -> int | None:
        """With which it ended; None: it runs."""
        return self._process.poll()

    def write(self, message: object) -> None:
        """Raises BrokenPipeError if the process has ended."""
        assert self._process.stdin is not None
        pickle.dump(message, self._process.stdin, protocol=pickle.HIGHEST_PROTOCOL)
        self._process.stdin.flush()

    def read(self) -> Any:
        """The next message. Raises EOFError if the process has ended."""
        assert self._process.stdout is not None
        try:
            return pickle.load(self._process.stdout)
        except pickle.UnpicklingError as error:
            raise EOFError("in the middle of a message") from error

    def has_message(self) -> bool:
        """Whether a first message, or the end, can be read without waiting."""
        assert self._process.stdout is not None
        return bool(select.select([self._process.stdout], [], [], 0.0)[0])

    def kill(self) -> None:
        """End it at once."""
        self._process.kill()

    def close(self) -> None:
        """End its messages, wait until it has ended, and kill it if that takes long. Closing again does nothing."""
        stdin, stdout = self._process.stdin, self._process.stdout
        assert stdin is not None
        assert stdout is not None
        with suppress(BrokenPipeError):
            stdin.close()
        try:
            self._process.wait(_ENDS_WITHIN_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        stdout.close()


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
    there are no more; and one that sends it a message, from any thread."""
    lock = threading.Lock()
    with os.fdopen(os.dup(sys.stdout.fileno()), "wb") as answers:
        sys.stdout = sys.stderr  # nothing else may get between the messages

        def receive() -> Any:
            return pickle.load(sys.stdin.buffer)

        def send(message: object) -> None:
            with lock:
                pickle.dump(message, answers, protocol=pickle.HIGHEST_PROTOCOL)
                answers.flush()

        yield receive, send
