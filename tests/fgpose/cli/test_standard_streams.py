"""A program that runs for days goes on without a terminal."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

# What a live system does with its streams: lines, a spinner, warnings, logs, and files of its own.
_PROGRAM = """
import logging, os, sys, warnings
from fgpose.cli.commands.live import ConsoleLog
from fgpose.cli.console import new_console
from fgpose.cli.process import forgiving_streams

with forgiving_streams():
    recording = open(sys.argv[1], "xb", buffering=0)
    console = new_console(stderr=True)
    logging.basicConfig(handlers=[ConsoleLog(console)])
    for _ in range(300):
        console.print("a line" * 10)
        logging.getLogger("fgpose").warning("of a camera")
        sys.stderr.write("fgpose: warning\\n")
        warnings.warn("of an estimator")
    os.system("echo of another program >&2")
    recording.write(b"whole")
"""


@pytest.mark.parametrize(
    "streams",
    [
        "2>/dev/full",
        "2>&1 >/dev/null | true",
        "<&- >&- 2>&-",
        *(pytest.param(one, marks=pytest.mark.slow) for one in ("2>&-", "<&-")),
    ],
)
def test_it_goes_on(tmp_path: Path, streams: str) -> None:
    program = tmp_path / "program.py"
    program.write_text(_PROGRAM)
    recording = tmp_path / "recording"
    command = f"set -o pipefail; {sys.executable} -P {program} {recording} {streams}"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    subprocess.run(["bash", "-c", command], check=True, env=environment, cwd=tmp_path, timeout=60, capture_output=True)
    assert recording.read_bytes() == b"whole"
