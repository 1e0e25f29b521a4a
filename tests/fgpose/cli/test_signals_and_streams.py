"""How a command ends by a signal, and where its streams lead nowhere."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from fgpose.cli import app
from fgpose.cli.app import main
from fgpose.cli.process import TERMINATED
from fgpose.io.atomic import write_text
from tests.fgpose.live.output_frames import wait_until


@pytest.fixture(autouse=True)
def signals_as_in_a_terminal() -> Iterator[None]:
    """A job in the background of a shell ignores Ctrl-C, and so would what is tested."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler), signal.signal(signal.SIGTERM, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGINT, before[0])
    signal.signal(signal.SIGTERM, before[1])


def command_that(monkeypatch: pytest.MonkeyPatch, run: object) -> None:
    """Parses nothing."""
    monkeypatch.setattr(app, "_parse", lambda arguments: SimpleNamespace(run=run))


@pytest.mark.parametrize("becomes", [KeyboardInterrupt, ImportError, RuntimeError, SystemError])
def test_an_interrupt_is_one_whatever_it_becomes(
    becomes: type[BaseException], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def run() -> None:
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            raise becomes("initialization failed") from None

    command_that(monkeypatch, run)
    before = signal.getsignal(signal.SIGINT)
    assert main([]) == 130
    assert capsys.readouterr().err == "fgpose: interrupted\n"
    assert signal.getsignal(signal.SIGINT) is before


def test_sigterm_removes_temporary_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from fgpose.io.atomic import replacing

    def run() -> None:
        with replacing(tmp_path / "result", lambda path: None):
            signal.raise_signal(signal.SIGTERM)

    command_that(monkeypatch, run)
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(SystemExit) as end:
        main([])
    assert end.value.code == TERMINATED
    assert not list(tmp_path.iterdir())
    assert signal.getsignal(signal.SIGTERM) is before


def test_signals_that_are_ignored_stay_so(monkeypatch: pytest.MonkeyPatch) -> None:
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        command_that(monkeypatch, lambda: signal.raise_signal(signal.SIGINT))
        assert main([]) == 0
    finally:
        signal.signal(signal.SIGINT, before)


# The imports of the command take a second: some streams are tried in one process each, the others in one.
_STREAMS = """
import os, sys
from fgpose.cli.app import main
def run(arguments):
    try:
        return main(arguments)
    except SystemExit as end:
        return end.code or 0
"""


def ended(code: str, *, stdin: str | None = None) -> str:
    run = subprocess.run(
        [sys.executable, "-c", _STREAMS + code], stderr=subprocess.PIPE, text=True, check=False, input=stdin
    )
    assert "Traceback" not in run.stderr
    assert "Exception ignored" not in run.stderr
    return f"{run.returncode} {run.stderr.strip()}"


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="a disk that is always full is of Linux")
def test_a_full_disk_behind_stdout_is_said(tmp_path: Path) -> None:
    code = "os.dup2(os.open('/dev/full', os.O_WRONLY), 1); sys.exit(run(['--version']))"
    assert ended(code) == "1 fgpose: error: cannot write the standard output: No space left on device"


@pytest.mark.parametrize("arguments", [["smooth", "--help"], ["--help"], ["skeletons"]])
def test_a_reader_who_has_gone_is_no_error(arguments: list[str]) -> None:
    code = f"reader, writer = os.pipe(); os.close(reader); os.dup2(writer, 1); sys.exit(run({arguments}))"
    assert ended(code) == "141 "


def test_closed_streams_are_no_error(tmp_path: Path) -> None:
    """What is printed must not get into the next file that is opened."""
    code = f"""
for number in (0, 1, 2):
    os.close(number)
sys.stdin = sys.stdout = sys.stderr = None
code = run(["info", "absent", "--rig", "absent", "--skeleton", "body_25b"])
file = os.open({str(tmp_path / "code")!r}, os.O_WRONLY | os.O_CREAT)
assert file > 2
os.write(file, str(code).encode())
"""
    ended(code)
    assert (tmp_path / "code").read_text() == "2"


def test_an_interrupt_while_modules_are_loaded_says_nothing(tmp_path: Path) -> None:
    """The first module that is loaded after the beginning sends it."""
    write_text(tmp_path / "numpy.py", "import os, signal; os.kill(os.getpid(), signal.SIGINT)")
    run = subprocess.run(
        [sys.executable, "-m", "fgpose", "--help"],
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (run.returncode, run.stdout, run.stderr) == (-signal.SIGINT, "", "")


_PROGRAM = "import os,subprocess,sys; print(os.getpid(), subprocess.Popen(['sleep','1000']).pid, flush=True)"
_PARENT = f"""
import sys
from fgpose.child_process import run_program
run_program([sys.executable, "-c", {_PROGRAM + "; import time; time.sleep(1000)"!r}])
"""


def is_running(process_id: int) -> bool:
    try:
        os.kill(process_id, 0)
    except ProcessLookupError:
        return False
    # Dead, but nobody has asked for its status: here init does it.
    try:
        return Path(f"/proc/{process_id}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except ProcessLookupError:
        return False
    except FileNotFoundError:
        # It has ended meanwhile, or there is no /proc.
        return not Path("/proc/self").exists()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_a_program_and_what_it_starts_end_with_the_command(number: signal.Signals) -> None:
    parent = subprocess.Popen([sys.executable, "-c", _PARENT], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    processes = [int(word) for word in parent.stdout.readline().split()]
    assert all(map(is_running, processes))
    parent.send_signal(number)
    parent.wait()
    wait_until(lambda: not any(map(is_running, processes)))
    parent.stdout.close()


def test_a_program_that_ends_says_how() -> None:
    from fgpose.child_process import run_program

    assert run_program([sys.executable, "-c", "import sys; sys.exit(7)"]) == 7


_POOL = """
import os, time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from fgpose.child_process import end_with_parent
if __name__ == "__main__":
    pool = ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=end_with_parent)
    print(pool.submit(os.getpid).result(), flush=True)
    pool.submit(time.sleep, 1000)
    time.sleep(1000)
"""


@pytest.mark.slow
def test_workers_end_with_a_command_that_is_killed(tmp_path: Path) -> None:
    write_text(tmp_path / "pool.py", _POOL)
    parent = subprocess.Popen([sys.executable, str(tmp_path / "pool.py")], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    worker = int(parent.stdout.readline())
    assert is_running(worker)
    parent.kill()
    parent.wait()
    wait_until(lambda: not is_running(worker))
    parent.stdout.close()
