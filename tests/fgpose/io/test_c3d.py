"""Damaged C3D files, on which ezc3d alone crashes, hangs or takes all memory."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_files import STICK, trajectory

from fgpose.io.trajectories import c3d_points, load_trajectory, save_trajectory
from fgpose.io.trajectories.c3d_points import C3dSize, check_size, read_points

_OF_FRAMES = ("time_s", "positions_m", "status", "covariance_m2", "residual_px", "visibility")

pytest.importorskip("ezc3d")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    save_trajectory(trajectory(), tmp_path / "result.c3d")
    return tmp_path / "result.c3d"


def set_words(path: Path, place: int, *words: int) -> None:
    content = bytearray(path.read_bytes())
    struct.pack_into(f"<{len(words)}H", content, place, *words)
    path.write_bytes(content)


def test_the_size_that_the_header_promises(path: Path) -> None:
    assert check_size(path) == C3dSize(STICK.n_joints, trajectory().n_frames)


@pytest.mark.parametrize(
    ("place", "words", "message"),
    [
        (0, [0x5100], "it has no C3D header"),
        (0, [0x50FF], "its header points to no parameters"),
        (2, [6000], "it holds 0 of 4 frames: it is truncated or damaged"),
        (4, [60000], "it holds 0 of 4 frames"),
        (8, [60000], "of 59900 frames"),
        (16, [0], "parameters go beyond its end"),
        (514, [0x54FF], "parameters go beyond its end"),
    ],
)
def test_a_header_that_does_not_fit_the_file_is_refused(path: Path, place: int, words: list[int], message: str) -> None:
    set_words(path, place, *words)
    with pytest.raises(ValueError, match=message):
        check_size(path)
    with pytest.raises(ValueError, match=r"result\.c3d: not a (readable C3D )?trajectory"):
        load_trajectory(path)


def test_a_truncated_file_says_how_much_is_left(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-512])
    with pytest.raises(ValueError, match=r"result\.c3d: not a readable C3D trajectory: it holds \d of 4 frames"):
        load_trajectory(path)


def other_reader(path: Path, monkeypatch: pytest.MonkeyPatch, program: str) -> None:
    """Another program in the place of the one that calls ezc3d."""
    program_path = path.with_name("reader.py")
    program_path.write_text(program)
    monkeypatch.setattr(c3d_points, "__file__", str(program_path))


def test_a_crash_of_the_reader_is_an_error_that_names_the_file(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    other_reader(path, monkeypatch, "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)")
    with pytest.raises(ValueError, match=r"result\.c3d: .*damaged: ezc3d crashed \(SIGSEGV\)"):
        load_trajectory(path)


def test_a_reader_that_never_ends_is_ended(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    other_reader(path, monkeypatch, "import time; time.sleep(60)")
    monkeypatch.setattr(c3d_points, "_TIME_LIMIT_S", 0.5)
    with pytest.raises(ValueError, match=r"result\.c3d: .*damaged: reading it took longer than"):
        load_trajectory(path)


def test_what_the_reader_says_is_passed_on(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    other_reader(path, monkeypatch, "raise KeyError('POINT')")
    with pytest.raises(ValueError, match=r"result\.c3d: .*damaged: KeyError: 'POINT'"):
        load_trajectory(path)


def test_a_reader_without_memory_is_an_error(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(c3d_points, "_MEMORY_LIMIT_BYTES", 1 << 26)
    monkeypatch.setattr(c3d_points, "_MEMORY_LIMIT_BYTES_PER_BYTE", 0)
    with pytest.raises(ValueError, match=r"result\.c3d: .*it is damaged"):
        load_trajectory(path)


def test_the_other_process_gives_what_ezc3d_gives(path: Path) -> None:
    ezc3d = pytest.importorskip("ezc3d")
    here, there = ezc3d.c3d(str(path)), read_points(path)
    np.testing.assert_array_equal(there["points"], here["data"]["points"])
    np.testing.assert_array_equal(there["residuals"], here["data"]["meta_points"]["residuals"][0])
    assert there["LABELS"].tolist() == here["parameters"]["POINT"]["LABELS"]["value"]
    assert there["first_frame"] == here["header"]["points"]["first_frame"]


def test_a_body_that_was_never_there_is_refused(tmp_path: Path) -> None:
    """ezc3d divides by the number of frames."""
    nothing = trajectory()
    nothing = replace(nothing, **{name: getattr(nothing, name)[:0] for name in _OF_FRAMES})
    with pytest.raises(ValueError, match=r"walk\.c3d: C3D holds at least one frame"):
        save_trajectory(nothing, tmp_path / "walk.c3d")
