"""fgpose view --web: one address, at which the recording is, and no lines of Rerun."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import threading
import urllib.parse
import urllib.request
from collections.abc import Iterator
from contextlib import closing, suppress
from functools import partial
from pathlib import Path

import pytest

from fgpose.cli.viewers import WebAddress
from fgpose.viewer import open_recording
from fgpose_benchmarks.synthetic import ring_rig

# Of Rerun, which a slow machine starts; nothing else takes long.
_PATIENCE_S = 60.0


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    import fgpose

    with open_recording(tmp_path / "walk.rrd", ring_rig(2), fgpose.load_skeleton("coco_17")):
        pass
    return tmp_path / "walk.rrd"


@pytest.fixture
def taken_port() -> Iterator[int]:
    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        yield server.getsockname()[1]


@pytest.fixture
def viewer(recording: Path) -> Iterator[subprocess.Popen[str]]:
    """The command with Rerun, in a group of its own, which ends with the test whatever happens. Ctrl-C reaches it also
    where the tests run in the background of a shell, which ignores it there."""
    command = [sys.executable, "-m", "fgpose", "view", str(recording), "--web"]
    environment = {name: value for name, value in os.environ.items() if name != "RUST_LOG"}
    with subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
        start_new_session=True,
        preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),
    ) as process:
        try:
            yield process
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)


def test_the_address_is_said_once_it_answers_and_ctrl_c_ends(viewer: subprocess.Popen[str]) -> None:
    assert viewer.stdout is not None
    first, second = viewer.stdout.readline(), viewer.stdout.readline()
    url = re.fullmatch(r"open (http://127\.0\.0\.1:\d+/\?url=\S+) in a browser; Ctrl-C ends\n", first)
    assert url, first
    with urllib.request.urlopen(url[1], timeout=_PATIENCE_S) as page:
        assert b"<html" in page.read().lower()
    data = urllib.parse.parse_qs(urllib.parse.urlsplit(url[1]).query)["url"]
    assert re.fullmatch(r"rerun\+http://127\.0\.0\.1:\d+/proxy", data[0])
    viewer.send_signal(signal.SIGINT)
    out, err = viewer.communicate(timeout=_PATIENCE_S)
    assert (viewer.returncode, out, err) == (0, "", "")
    assert re.fullmatch(
        r"From another computer, first: ssh -L \d+:localhost:\d+ -L \d+:localhost:\d+ THIS_COMPUTER\n", second
    )


def test_ports_that_are_taken_are_replaced(taken_port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fgpose.cli.viewers._PAGE_PORT", taken_port)
    assert WebAddress.free("127.0.0.1").page_port != taken_port
    with pytest.raises(OSError, match=r"--host 192\.0\.2\.1: that is no address of this computer"):
        WebAddress.free("192.0.2.1")


def test_others_are_told_an_address_that_they_reach(capsys: pytest.CaptureFixture[str]) -> None:
    """Rerun names localhost to them, which is their own computer."""
    with (
        closing(socket.create_server(("0.0.0.0", 0))) as page,
        closing(socket.create_server(("0.0.0.0", 0))) as data,
    ):
        address = WebAddress("0.0.0.0", page.getsockname()[1], data.getsockname()[1])
        address._say_when_reached(threading.Event())
    here, others = capsys.readouterr().out.splitlines()
    assert here.startswith(f"open http://127.0.0.1:{address.page_port}/?url=")
    assert others == f"From another computer: {address.url(socket.gethostname())}"
