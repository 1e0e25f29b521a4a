"""Readers that do what no reader may, to see that the fuzzer notices."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

from small_files import Format


def _die(folder: Path) -> None:
    os.kill(os.getpid(), signal.SIGSEGV)


def _raise(error: Exception) -> Callable[[Path], NoReturn]:
    def read(folder: Path) -> NoReturn:
        raise error

    return read


FORMATS = {
    name: Format(name, "text", lambda folder: (folder / "file.txt").write_text("1 2 3"), read)
    for name, read in (
        ("death", _die),
        ("hang", lambda folder: time.sleep(60)),
        ("wrong exception", _raise(KeyError("file.txt"))),
        ("unnamed", _raise(ValueError("it is damaged"))),
        ("long", _raise(ValueError(f"file.txt is {'x' * 100_000}"))),
        ("refused", _raise(ValueError("file.txt is damaged"))),
        ("read", lambda folder: None),
    )
}
