"""What is replaced, and what is not; what a kill leaves behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from fgpose.io.atomic import (
    NotWrittenError,
    check_replaceable,
    check_writable,
    no_empty_folders,
    replacing,
    write_bytes,
    write_text,
)


def never(path: Path) -> None:
    """A check."""


def make_device(path: Path) -> None:
    path.symlink_to("/dev/null")


def make_pipe_behind_a_link(path: Path) -> None:
    os.mkfifo(path.with_suffix(".pipe"))
    path.symlink_to(path.with_suffix(".pipe"))


def make_circle(path: Path) -> None:
    path.symlink_to(path)


@pytest.mark.parametrize("make", [os.mkfifo, make_device, make_pipe_behind_a_link, make_circle, Path.mkdir])
def test_only_plain_files_are_replaced(tmp_path: Path, make: Callable[[Path], None]) -> None:
    path = tmp_path / "result.toml"
    make(path)
    before = path.lstat()
    for write in (check_replaceable, lambda path: write_text(path, "new")):
        with pytest.raises(OSError, match=f"cannot write {path}: it is (a folder|no plain file)"):
            write(path)
    assert path.lstat().st_ino == before.st_ino
    assert not list(tmp_path.glob(".fgpose*"))


@pytest.mark.parametrize("is_there", [False, True])
def test_a_link_is_followed(tmp_path: Path, is_there: bool) -> None:
    target, link = tmp_path / "elsewhere" / "result.toml", tmp_path / "result.toml"
    link.symlink_to(Path("elsewhere", "result.toml"))
    if is_there:
        write_text(target, "old")
    write_text(link, "new")
    assert link.is_symlink()
    assert target.read_text() == "new"
    assert not target.is_symlink()


@pytest.mark.parametrize("mode", [0o600, 0o640, 0o444])
def test_permissions_stay(tmp_path: Path, mode: int) -> None:
    path = tmp_path / "result.toml"
    write_text(path, "old")
    path.chmod(mode)
    with replacing(path, never) as temporary:
        # Nobody else reads it before it is complete.
        assert temporary.stat().st_mode & 0o077 == 0
        temporary.write_text("new")
    assert path.read_text() == "new"
    assert path.stat().st_mode & 0o777 == mode


def test_a_new_file_has_the_permissions_of_new_files(tmp_path: Path) -> None:
    (tmp_path / "other").touch()
    write_text(tmp_path / "result.toml", "new")
    assert (tmp_path / "result.toml").stat().st_mode == (tmp_path / "other").stat().st_mode


def test_what_a_kill_leaves_is_removed_by_the_next(tmp_path: Path) -> None:
    code = """
import sys, time
from pathlib import Path
from fgpose.io.atomic import replacing
with replacing(Path(sys.argv[1]), lambda path: None) as temporary:
    temporary.write_text("half")
    print(temporary, flush=True)
    time.sleep(1000)
"""
    writers = [
        subprocess.Popen([sys.executable, "-c", code, str(tmp_path / f"{n}.toml")], stdout=subprocess.PIPE, text=True)
        for n in range(2)
    ]
    killed, alive = [Path(str(writer.stdout and writer.stdout.readline()).strip()) for writer in writers]
    writers[0].send_signal(signal.SIGKILL)
    writers[0].wait()
    like_it = tmp_path / ".fgpose-notes"
    like_it.touch()
    check_writable(tmp_path)
    assert not killed.exists()
    assert alive.read_text() == "half"
    assert like_it.exists()
    writers[1].kill()
    for writer in writers:
        writer.communicate()


def test_an_error_of_another_file_keeps_its_name(tmp_path: Path) -> None:
    def fail() -> None:
        with replacing(tmp_path / "result.toml", never):
            (tmp_path / "absent").read_text()

    with pytest.raises(FileNotFoundError, match="absent"):
        fail()
    assert not list(tmp_path.iterdir())


def test_an_error_is_said_once(tmp_path: Path) -> None:
    with (
        pytest.raises(NotWrittenError, match=f"^cannot write {tmp_path / 'a'}: no$"),
        replacing(tmp_path / "b", never),
        replacing(tmp_path / "a", never),
    ):
        raise OSError("no")


def test_a_long_name_is_written(tmp_path: Path) -> None:
    write_bytes(tmp_path / ("n" * 250 + ".npz"), b"new")
    assert [path.name for path in tmp_path.iterdir()] == ["n" * 250 + ".npz"]


@pytest.mark.parametrize("kept", [None, "made before", "full"])
def test_an_error_leaves_no_empty_folder(kept: str | None, tmp_path: Path) -> None:
    folder = tmp_path / "a" / "b"
    if kept == "made before":
        folder.mkdir(parents=True)

    def failing() -> None:
        with no_empty_folders(folder):
            folder.mkdir(parents=True, exist_ok=True)
            if kept == "full":
                (folder / "result").touch()
            raise ValueError

    with pytest.raises(ValueError, match=r"^$"):
        failing()
    assert folder.exists() == bool(kept)
    assert (tmp_path / "a").exists() == bool(kept)
