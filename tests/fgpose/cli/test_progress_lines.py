"""What a command says of its progress into a file."""

from __future__ import annotations

import errno
import io
from itertools import count
from pathlib import Path
from types import SimpleNamespace

import pytest

from fgpose.cli import console
from fgpose.cli.console import PlainConsole, ProgressLines, new_console, progress_bar, quiet_progress
from fgpose.cli.delivery import windows_kept
from fgpose.io.atomic import write_text
from fgpose.pipeline import Outputs
from tests.fgpose.live.output_frames import wait_until


def test_a_long_step_is_not_silent(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Although nothing is counted meanwhile."""
    monkeypatch.setattr(console, "_LINE_EVERY_S", 0.01)
    said = ""

    def has_gone_on() -> bool:
        nonlocal said
        said += capsys.readouterr().err
        return said.count("\n") > 3

    with new_console(stderr=True).status("looking"):
        wait_until(has_gone_on)
    assert all(line.startswith("looking: after 0:00:0") for line in said.splitlines())


def test_what_is_done_and_how_long_the_rest_will_take(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A run that did not end had done half of it: 100 of the other 500 frames take 60 s."""
    times_s = count(0.0, 60.0)
    monkeypatch.setattr(console, "time", SimpleNamespace(monotonic=lambda: next(times_s)))
    lines = ProgressLines(new_console(stderr=True), "smoothing", "frames")
    lines.told(500, 1000)
    assert lines._line("after ") == "smoothing: 500 of 1000 frames (50 %) after 0:02:00"
    lines.told(600, 1000)
    assert lines._line("after ") == "smoothing: 600 of 1000 frames (60 %) after 0:04:00, 0:08:00 left"
    assert capsys.readouterr().err == ""


def test_a_short_step_says_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    """Bad input stays one line."""
    with new_console(stderr=True).status("looking"):
        pass
    assert capsys.readouterr().err == ""


def test_lines_end_with_the_bar(capsys: pytest.CaptureFixture[str]) -> None:
    with progress_bar("detecting", "images") as progress:
        progress(0, 0)
        progress(30, 30)
    assert capsys.readouterr().err == "detecting\ndetecting: 30 of 30 images (100 %) in 0:00:00\n"


def test_what_is_usually_short_says_nothing_unless_it_takes_long(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with quiet_progress("looking") as progress:
        progress(1, 2)
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(console, "_LINE_EVERY_S", 0.01)
    said = ""

    def has_said_how_far_it_is() -> bool:
        nonlocal said
        said += capsys.readouterr().err
        return "looking: 1 of 4 steps (25 %) after 0:00:0" in said

    with quiet_progress("looking") as progress:
        progress(1, 4)
        wait_until(has_said_how_far_it_is)


def test_a_terminal_has_its_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = io.StringIO()
    monkeypatch.setattr(console, "new_console", lambda stderr: PlainConsole(file=terminal, force_terminal=True))
    monkeypatch.setenv("TERM", "xterm")
    with progress_bar("detecting", "images") as progress:
        progress(30, 30)
    assert "━" in terminal.getvalue()
    assert "detecting: " not in terminal.getvalue()


def test_nobody_needs_to_read_them() -> None:
    tried = []

    class Full(io.StringIO):
        def write(self, text: str) -> int:
            tried.append(text)
            raise OSError(errno.ENOSPC, "No space left on device")

    with ProgressLines(PlainConsole(file=Full()), "smoothing", "frames") as lines:
        lines.told(1, 1)
        tried.append("the work")
    # Both lines failed, and neither stopped what they tell of.
    assert tried[:2] == ["smoothing\n", "the work"]
    assert tried[-1].endswith("smoothing: 1 of 1 frames (100 %) in 0:00:00\n")


def test_windows_of_other_runs_are_not_called_kept(tmp_path: Path) -> None:
    outputs = Outputs(tmp_path, "walk", ("npz",))

    def solved(run: str, number: int) -> None:
        write_text(outputs.unfinished / run / f"{number:05}.npz", "")

    (outputs.unfinished / "of another").mkdir(parents=True)
    (outputs.unfinished / "own").mkdir()
    solved("of another", 0)
    with pytest.raises(KeyboardInterrupt) as interrupt, windows_kept(outputs):
        raise KeyboardInterrupt
    assert not getattr(interrupt.value, "__notes__", ())
    solved("own", 0)

    def interrupted() -> None:
        with windows_kept(outputs):
            solved("own", 1)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt) as interrupt:
        interrupted()
    assert interrupt.value.__notes__ == [
        f"2 windows that are solved are kept in {outputs.unfinished}; the same command goes on from there"
    ]
