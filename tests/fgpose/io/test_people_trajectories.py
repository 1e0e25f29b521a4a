"""Files with the trajectories of several people, there and back."""

from __future__ import annotations

import csv
import dataclasses
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from small_files import STICK, assert_same, trajectory

from fgpose.io.skeletons import load_skeleton
from fgpose.io.trajectories import (
    EXTENSIONS,
    load_people_trajectories,
    load_trajectory,
    people_paths,
    save_people,
    save_trajectory,
)
from fgpose.trajectory import Convergence, Trajectory


def between(first: int, end: int, seed: int) -> Trajectory:
    """Somebody who is there in some frames of a recording at 50 Hz, everything known that can be."""
    rng, whole = np.random.default_rng(seed), trajectory()
    n_frames = end - first

    def own(array: np.ndarray) -> Any:
        return array[rng.integers(0, len(array), n_frames)] * rng.uniform(0.5, 1.0)

    return dataclasses.replace(
        whole,
        time_s=np.arange(first, end) / 50,
        bone_lengths_m=rng.uniform(0.1, 0.5, STICK.n_lengths),
        convergence=Convergence(seed % 2 == 0, 5 + seed, 10.0, 1 / 3),
        status=whole.status[rng.integers(0, whole.n_frames, n_frames)],
        **{name: own(getattr(whole, name)) for name in ("positions_m", "covariance_m2", "residual_px", "visibility")},
    )


@pytest.fixture
def people() -> dict[int, Trajectory]:
    """Seen most first: one is always there, one comes late, one leaves early; nobody is there in frame 7."""
    return {2: between(0, 7, 2), 0: between(3, 7, 3), 5: between(0, 2, 4), 11: between(8, 10, 5)}


def test_people_who_come_and_go_survive_a_table_exactly(people, tmp_path):
    path = tmp_path / "result.parquet"
    assert save_people(people, path) == (path,) == people_paths(path)
    loaded = load_people_trajectories(path)
    assert list(loaded) == [2, 0, 5, 11]
    for person, own in loaded.items():
        assert_same(own, people[person])


def test_a_table_of_people_needs_no_fgpose(people, tmp_path):
    save_people(people, tmp_path / "result.parquet")
    table = pq.read_table(tmp_path / "result.parquet")
    save_trajectory(people[2], tmp_path / "one.parquet")
    assert table.schema.equals(pq.read_schema(tmp_path / "one.parquet"))
    rows = table.to_pylist()
    assert len(rows) == (7 + 4 + 2 + 2) * STICK.n_joints
    row = rows[(7 + 1) * STICK.n_joints + 3]
    assert (row["person"], row["frame"], row["time_s"], row["joint"]) == (0, 4, 4 / 50, "neck")
    assert row["y_m"] == people[0].positions_m[1, 3, 1]
    assert table["person"].null_count == 0
    assert pa.types.is_integer(table.schema.field("person").type)
    # Times at which somebody is there: nobody is in the seventh, so the eighth is the next.
    frames = table.group_by("person").aggregate([("frame", "min"), ("frame", "max")]).to_pylist()
    assert {each["person"]: (each["frame_min"], each["frame_max"]) for each in frames} == {
        **{2: (0, 6), 0: (3, 6)},
        **{5: (0, 1), 11: (7, 8)},
    }


def test_metadata_that_everybody_shares_are_there_once(people, tmp_path):
    save_people(people, tmp_path / "result.parquet")
    keys = {key.decode() for key in pq.read_schema(tmp_path / "result.parquet").metadata if key.startswith(b"fgpose.")}
    shared = {"skeleton", "camera_names", "config", "has_covariance", "bone_length_sigma_m"}
    own = {f"{name}.{person}" for name in ("bone_lengths_m", "convergence") for person in people}
    assert {key.removeprefix("fgpose.") for key in keys} == shared | own


def test_frames_are_those_of_the_recording(people, tmp_path):
    path = tmp_path / "result.parquet"
    save_people(people, path, time_s=np.arange(12) / 50)
    frame = {row["frame"] for row in pq.read_table(path).to_pylist() if row["person"] == 11}
    assert frame == {8, 9}
    # The last digits of a time depend on the order of a sum.
    save_people(people, path, time_s=np.nextafter(np.arange(12) / 50, 1.0))
    assert {row["frame"] for row in pq.read_table(path).to_pylist() if row["person"] == 11} == frame
    assert_same(load_people_trajectories(path)[11], people[11])


def test_one_person_is_written_as_ever(people, tmp_path):
    save_people({0: people[2]}, tmp_path / "people.parquet")
    save_trajectory(people[2], tmp_path / "one.parquet")
    assert (tmp_path / "people.parquet").read_bytes() == (tmp_path / "one.parquet").read_bytes()
    assert_same(load_trajectory(tmp_path / "people.parquet"), people[2])
    save_people({7: people[0]}, tmp_path / "people.parquet")
    assert list(load_people_trajectories(tmp_path / "people.parquet")) == [7]
    assert_same(load_trajectory(tmp_path / "people.parquet"), people[0])


@pytest.mark.parametrize("extension", [".npz", ".trc", ".c3d"])
def test_other_formats_have_a_file_for_each(people, tmp_path, extension):
    if extension == ".c3d":
        pytest.importorskip("ezc3d")
    path = tmp_path / f"walk{extension}"
    written = save_people(people, path)
    assert [each.name for each in written] == [f"walk_person{person}{extension}" for person in (2, 0, 5, 11)]
    assert written == people_paths(path, people)
    assert sorted(tmp_path.iterdir()) == sorted(written)
    for person, own_path in zip(people, written, strict=True):
        own = load_people_trajectories(own_path, STICK)
        assert list(own) == [0]
        # C3D has millimetres in single precision: 24 bits of 3 m.
        np.testing.assert_allclose(own[0].positions_m, people[person].positions_m, atol=3e-7)
        np.testing.assert_allclose(own[0].time_s, people[person].time_s, atol=1e-9)


@pytest.mark.parametrize("extension", EXTENSIONS)
def test_whoever_is_alone_has_a_file_of_that_name(people, tmp_path, extension):
    if extension == ".c3d":
        pytest.importorskip("ezc3d")
    path = tmp_path / f"walk{extension}"
    assert save_people({2: people[2]}, path) == (path,) == people_paths(path, [2])
    assert list(tmp_path.iterdir()) == [path]


def test_everybody_is_in_one_table_as_csv(people, tmp_path):
    """The same cells as in parquet; a joint whose name is a formula is none."""
    evil = dataclasses.replace(STICK, joints=("=1+1", *STICK.joints[1:]))
    named = {person: dataclasses.replace(each, skeleton=evil) for person, each in people.items()}
    for extension in (".csv", ".parquet"):
        assert save_people(named, tmp_path / f"result{extension}") == (tmp_path / f"result{extension}",)
    table = pq.read_table(tmp_path / "result.parquet")
    with (tmp_path / "result.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["joint"] for row in rows] == [name.replace("=1+1", "'=1+1") for name in table["joint"].to_pylist()]
    for name in ("person", "x_m", "cov_xz_m2"):
        assert [float(row[name]) if row[name] else None for row in rows] == table[name].to_pylist()
    assert {row["status"] for row in rows} == set(table["status"].to_pylist())


def test_a_table_of_several_is_no_single_trajectory(people, tmp_path):
    save_people(people, tmp_path / "result.parquet")
    with pytest.raises(ValueError, match=r"result\.parquet: .*people 2, 0, 5, 11; load_people_trajectories") as refused:
        load_trajectory(tmp_path / "result.parquet")
    assert str(refused.value).count("result.parquet") == 1


def test_people_come_with_the_joints_asked_for(people, tmp_path):
    save_people(people, tmp_path / "result.parquet")
    wanted = load_skeleton("body_25")
    loaded = load_people_trajectories(tmp_path / "result.parquet", wanted)
    assert {each.skeleton for each in loaded.values()} == {wanted}
    np.testing.assert_array_equal(loaded[5]["left_knee"], people[5]["left_knee"])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda people: {}, "people with numbers from 0 are needed, got nobody"),
        (lambda people: {-1: people[2]}, "people with numbers from 0 are needed, got -1"),
        (lambda people: people | {3: stopped(people[2])}, "person 3 must have frames whose time_s increases"),
        (lambda people: people | {3: reskeletoned(people[2])}, "people 2 and 3 differ in their skeleton"),
        (
            lambda people: people | {3: dataclasses.replace(people[2], covariance_m2=None)},
            "only one of people 2 and 3 has covariance_m2",
        ),
    ],
)
def test_people_who_cannot_share_a_table_are_named(people, tmp_path, change, message):
    with pytest.raises(ValueError, match=rf"result\.parquet: {message}"):
        save_people(change(people), tmp_path / "result.parquet")
    assert not list(tmp_path.iterdir())


def stopped(own: Trajectory) -> Trajectory:
    return dataclasses.replace(own, time_s=np.zeros(own.n_frames))


def reskeletoned(own: Trajectory) -> Trajectory:
    return dataclasses.replace(own, skeleton=dataclasses.replace(own.skeleton, name="other"))


def test_a_frame_that_the_recording_lacks_is_named(people, tmp_path):
    with pytest.raises(ValueError, match=r"person 2 has a frame at 0\.1 s, the recording has none then"):
        save_people(people, tmp_path / "result.parquet", time_s=np.arange(5) / 50)
    with pytest.raises(ValueError, match="time_s of the recording must increase"):
        save_people(people, tmp_path / "result.parquet", time_s=np.zeros(5))
    one = dataclasses.replace(people[5], time_s=np.array([0.1, 0.1 + 1e-9]))
    with pytest.raises(ValueError, match=r"person 5 has a frame at 0\.1 s, the recording has none then"):
        save_people({5: one}, tmp_path / "result.parquet", time_s=np.arange(9) / 50)


@pytest.mark.parametrize("extension", EXTENSIONS)
def test_an_impossible_path_is_refused_before_the_work(people, tmp_path, extension):
    with pytest.raises(ValueError, match="a trajectory is written as"):
        people_paths(tmp_path / f"result{extension}s", people)
    (tmp_path / "file").write_text("")
    if extension == ".c3d":
        pytest.importorskip("ezc3d")
    with pytest.raises(OSError, match="cannot write results into"):
        save_people(people, tmp_path / "file" / f"result{extension}")


def test_people_may_be_mixed_but_joints_not(people, tmp_path):
    path = tmp_path / "result.parquet"
    save_people(people, path)
    table = pq.read_table(path)
    n_rows, n_joints = table.num_rows, STICK.n_joints
    # As a table sorted by time is.
    by_frame = np.lexsort((np.arange(n_rows), table["frame"].to_numpy()))
    pq.write_table(table.take(by_frame), path)
    for person, own in load_people_trajectories(path).items():
        assert_same(own, people[person])
    for wrong in (np.arange(1, n_rows), np.delete(np.arange(n_rows), 7 * n_joints + 3), np.arange(n_rows)[::-1]):
        pq.write_table(table.take(wrong), path)
        with pytest.raises(ValueError, match=r"result\.parquet.*person \d+: rows are missing or in another order"):
            load_people_trajectories(path)


@pytest.mark.parametrize("person", [[None], [0.5], [-1.0]])
def test_a_row_of_no_person_is_refused(people, tmp_path, person):
    path = tmp_path / "result.parquet"
    save_people(people, path)
    table = pq.read_table(path)
    column = pa.array(person + table["person"].to_pylist()[1:], pa.float64())
    pq.write_table(table.set_column(table.column_names.index("person"), "person", column), path)
    with pytest.raises(ValueError, match=r"result\.parquet.*a row whose person is no number from 0"):
        load_people_trajectories(path)
