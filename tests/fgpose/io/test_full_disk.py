"""Whatever cannot be written whole leaves the file of the run before as it was, and says which file it is."""

from __future__ import annotations

import multiprocessing
import os
import resource
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from small_files import recording, rig, trajectory, walk

from fgpose.io.atomic import replacing, write_bytes
from fgpose.io.calibration import save_rig
from fgpose.io.keypoints import save_observations
from fgpose.io.trajectories import save_trajectory
from fgpose.io.trajectories.kinematics import save_kinematics
from fgpose.viewer import open_recording
from fgpose_benchmarks.human36m.predictions import SequencePrediction, save_predictions

OLD = b"the good file of the run before"


def _save_rrd(path: Path) -> None:
    with open_recording(path, rig(), recording().skeleton, ("smoothed",)) as shown:
        shown.log_observations(recording())


POSE = SequencePrediction(np.arange(1), np.zeros((1, 17, 3)))
WRITERS: dict[str, Callable[[Path], object]] = {
    "result.parquet": lambda path: save_trajectory(trajectory(), path),
    "result.npz": lambda path: save_trajectory(trajectory(), path),
    "result.trc": lambda path: save_trajectory(trajectory(), path),
    "result.c3d": lambda path: save_trajectory(trajectory(), path),
    "angles.parquet": lambda path: save_kinematics(walk(), path),
    "angles.mot": lambda path: save_kinematics(walk(), path),
    "angles.bvh": lambda path: save_kinematics(walk(), path),
    "angles.c3d": lambda path: save_kinematics(walk(), path),
    "rig.toml": lambda path: save_rig(rig(), path),
    "rig.npz": lambda path: save_rig(rig(), path),
    "seen.npz": lambda path: save_observations(recording(), path),
    "seen.parquet": lambda path: save_observations(recording(), path),
    "poses.npz": lambda path: save_predictions({("S9", "Eating-1"): POSE}, path),
    "result.rrd": _save_rrd,
}


# Of the size of the whole file: nothing, the middle of the numbers, what a format has at its end.
SHARES = (0.0, 0.5, 0.95)


def _fill_disks(folder: Path, answers: multiprocessing.Queue[tuple[str, float, str]]) -> None:
    """Python ignores the signal of the limit: writes beyond it fail as on a full disk, with another number."""
    for name, write in WRITERS.items():
        whole = folder / "whole" / name
        write(whole)
        for share in SHARES:
            path = folder / f"{name} {share}" / name
            path.parent.mkdir()
            path.write_bytes(OLD)
            limit_bytes = int(share * whole.stat().st_size)
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit_bytes, resource.RLIM_INFINITY))
            try:
                write(path)
                answer = "written"
            except Exception as error:
                answer = f"{type(error).__name__}: {error}"
            resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
            answers.put((name, share, answer))


@pytest.fixture(scope="module")
def full_disks(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[tuple[str, float], str]]:
    """The folder, and what came of writing each file with less space than it needs; in a process of its own."""
    pytest.importorskip("ezc3d")
    folder = tmp_path_factory.mktemp("disks")
    context = multiprocessing.get_context("spawn")
    answers = context.Queue()
    process = context.Process(target=_fill_disks, args=(folder, answers))
    process.start()
    found = [answers.get(timeout=120) for _ in WRITERS for _ in SHARES]
    process.join()
    return folder, {(name, share): answer for name, share, answer in found}


@pytest.mark.parametrize("share", SHARES)
@pytest.mark.parametrize("name", WRITERS)
def test_a_full_disk_leaves_the_old_file_and_no_other(
    full_disks: tuple[Path, dict[tuple[str, float], str]], name: str, share: float
) -> None:
    folder, answers = full_disks
    path = folder / f"{name} {share}" / name
    assert answers[name, share].startswith("NotWrittenError: ")
    assert str(path) in answers[name, share]
    assert path.read_bytes() == OLD
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize("name", [name for name in WRITERS if not name.endswith(".rrd")])
def test_with_space_enough_the_old_file_is_replaced(tmp_path: Path, name: str) -> None:
    # The .rrd is in test_viewer.
    path = tmp_path / name
    path.write_bytes(OLD)
    WRITERS[name](path)
    assert path.read_bytes() != OLD
    assert list(tmp_path.iterdir()) == [path]


def test_what_a_library_leaves_out_is_seen_before_the_old_file_goes(tmp_path: Path) -> None:
    path = tmp_path / "result.c3d"
    path.write_bytes(OLD)

    def check(written: Path) -> None:
        raise ValueError(f"{written}: 3 of 5 frames")

    with (
        pytest.raises(OSError, match=r"cannot write .*result\.c3d: .*result\.c3d: 3 of 5 frames"),
        replacing(path, check) as new,
    ):
        new.write_bytes(b"new")
    assert path.read_bytes() == OLD
    assert list(tmp_path.iterdir()) == [path]


def test_a_write_that_falls_short_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "result.json"
    path.write_bytes(OLD)
    monkeypatch.setattr(os, "fsync", lambda file: os.ftruncate(file, 2))
    with pytest.raises(OSError, match=r"result\.json: .*2 of 3 bytes"):
        write_bytes(path, b"abc")
    assert path.read_bytes() == OLD
