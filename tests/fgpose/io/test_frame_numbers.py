"""Frames have the numbers of the recording in every table, also of somebody who comes late."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from fgpose.cli import main
from fgpose.diagnosis.finished import FinishedRecording
from fgpose.io.skeletons import load_skeleton
from fgpose.io.trajectories import load_people_trajectories, load_trajectory, save_people, save_trajectory
from fgpose.io.trajectories.kinematics import load_angles, save_kinematics
from fgpose.io.trajectories.over_time import table_over_time
from fgpose.kinematics.angles import joint_angles
from fgpose.report.blocks import PicturedMoment
from fgpose.report.sections.moments import moment_section
from fgpose.trajectory import Status, Trajectory
from fgpose_benchmarks.synthetic import walking

FPS, FIRST = 50.0, 100
TIME_S = np.arange(160) / FPS
NUMBERS = np.arange(FIRST, len(TIME_S))


@pytest.fixture(scope="module")
def late() -> Trajectory:
    """Somebody who comes at 2 s; it is not known which frames of a recording these are."""
    positions_m = walking(len(NUMBERS), FPS)
    status = np.full(positions_m.shape[:2], Status.OBSERVED)
    return Trajectory(load_skeleton("h36m_17"), TIME_S[FIRST:], positions_m, status)


@pytest.fixture
def result(late: Trajectory, tmp_path: Path) -> Path:
    """Of a recording in which nobody is there at first."""
    (path,) = save_people({3: late}, tmp_path / "late.parquet", time_s=TIME_S)
    return path


def frames_of(path: Path) -> list[int]:
    return np.unique(pq.read_table(path)["frame"].to_numpy()).tolist()


def test_angles_have_the_frames_of_their_result(result: Path, tmp_path: Path) -> None:
    assert frames_of(result) == NUMBERS.tolist()
    assert main(["angles", str(result), "--world-up", "z", "-o", str(tmp_path / "angles.parquet")]) == 0
    assert frames_of(tmp_path / "angles.parquet") == NUMBERS.tolist()
    np.testing.assert_array_equal(load_angles(tmp_path / "angles.parquet")[3].frame_numbers, NUMBERS)


@pytest.mark.parametrize("extension", [".parquet", ".npz"])
def test_a_result_that_is_saved_again_keeps_its_numbers(result: Path, tmp_path: Path, extension: str) -> None:
    save_trajectory(load_trajectory(result)[10:20], tmp_path / f"part{extension}")
    np.testing.assert_array_equal(load_trajectory(tmp_path / f"part{extension}").frame_numbers, NUMBERS[10:20])
    save_people(load_people_trajectories(result), tmp_path / "again.parquet")
    assert frames_of(tmp_path / "again.parquet") == NUMBERS.tolist()


@pytest.mark.parametrize("extension", [".npz", ".trc"])
def test_files_of_one_person_have_the_numbers_of_the_table(late: Trajectory, tmp_path: Path, extension: str) -> None:
    path = tmp_path / f"late{extension}"
    save_people({3: late}, path, time_s=TIME_S)
    np.testing.assert_array_equal(load_trajectory(path).frame_numbers, NUMBERS)
    save_trajectory(late, path)  # whose numbers are not known
    np.testing.assert_array_equal(load_trajectory(path).frame_numbers, np.arange(late.n_frames))


@pytest.mark.parametrize("form", ["long", "wide"])
def test_tables_in_python_have_them_too(result: Path, form) -> None:
    motion = load_trajectory(result)
    for shown in (motion, joint_angles(motion)):
        assert np.unique(table_over_time(shown, form)["frame"].to_numpy()).tolist() == NUMBERS.tolist()


def test_what_is_put_together(late: Trajectory) -> None:
    known = replace(late, frame_numbers=NUMBERS)
    whole = Trajectory.concatenate([known[:10], known[20:]])
    np.testing.assert_array_equal(whole.frame_numbers, np.delete(NUMBERS, slice(10, 20)))
    again = replace(known, time_s=known.time_s + 10)
    assert Trajectory.concatenate([known, again]).frame_numbers is None  # another recording: they do not go on
    assert Trajectory.concatenate([known[:10], late[10:]]).frame_numbers is None
    with pytest.raises(ValueError, match="frame_numbers must be"):
        replace(late, frame_numbers=NUMBERS[1:])


def test_worst_moments_name_frames_that_are_known(late: Trajectory) -> None:
    def titles(trajectory: Trajectory) -> list[str]:
        blocks = moment_section(FinishedRecording("late", {3: trajectory})).blocks
        return [block.title for block in blocks if isinstance(block, PicturedMoment)]

    known, unknown = titles(replace(late, frame_numbers=NUMBERS)), titles(late)
    assert known
    for title in known:
        time_s, _, rest = title.partition(" s (frame ")
        assert int(rest.partition(")")[0]) == round(float(time_s) * FPS)
    assert not any("frame" in title for title in unknown)


def test_damaged_numbers_are_refused(late: Trajectory, tmp_path: Path) -> None:
    path = tmp_path / "late.npz"
    for numbers, message in ((NUMBERS[::-1], "does not increase"), (NUMBERS + 0.5, "no number from 0 to 1000000000")):
        save_trajectory(replace(late, frame_numbers=np.ascontiguousarray(numbers)), path)
        with pytest.raises(ValueError, match=rf"late\.npz.*{message}"):
            load_trajectory(path)


def test_somebody_without_numbers_is_numbered_by_the_times_of_all(late: Trajectory, tmp_path: Path) -> None:
    early = replace(late, time_s=TIME_S[: late.n_frames], frame_numbers=np.arange(late.n_frames))
    save_kinematics({0: early, 1: late}, tmp_path / "angles.parquet", "z")
    table = pq.read_table(tmp_path / "angles.parquet").to_pandas()
    times_s = np.union1d(early.time_s, late.time_s)
    np.testing.assert_array_equal(times_s[table.frame], table.time_s)
