"""Parquet files whose columns or metadata are something else than they should be."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from small_files import STICK, recording, rig, trajectory

from fgpose.io.keypoints import load_observations, save_observations
from fgpose.io.trajectories import load_trajectory, save_trajectory


def damaged(path: Path, **columns: pa.Array) -> Path:
    table = pq.read_table(path)
    for name, column in columns.items():
        table = table.set_column(table.column_names.index(name), name, column)
    pq.write_table(table, path)
    return path


ODD: dict[str, tuple[Any, str]] = {
    "x_m": ([[1.0]], "column x_m does not contain numbers but list"),
    "time_s": (["x"], "column time_s does not contain numbers but string"),
    "frame": ([{"a": 1}], "column frame does not contain numbers but struct"),
    "joint": ([[1]], "column joint does not contain names but list"),
    "status": (["seen"], "'seen' is none of unobservable, predicted, observed"),
    "cov_xx_m2": ([True], "column cov_xx_m2 does not contain numbers but bool"),
}


@pytest.mark.parametrize("name", ODD)
def test_a_column_of_another_type_is_named(tmp_path: Path, name: str) -> None:
    value, message = ODD[name]
    path = tmp_path / "result.parquet"
    save_trajectory(trajectory(), path)
    damaged(path, **{name: pa.array(value * trajectory().n_frames * STICK.n_joints)})
    with pytest.raises(ValueError, match=rf"result\.parquet: not a readable parquet trajectory: .*{message}"):
        load_trajectory(path)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("skeleton", [1, 2], "its skeleton is damaged: a table is needed"),
        ("skeleton", {"name": "stick"}, "its skeleton is damaged: joints, bones"),
        ("camera_names", {"a": 1}, "its camera_names is damaged: a list of names"),
        ("camera_names", [1], "its camera_names is damaged: a list of names"),
        ("bone_lengths_m", ["long"], "its bone_lengths_m is damaged: a number or null"),
        ("bone_lengths_m", [10**400], "its bone_lengths_m is damaged: a number or null"),
        ("convergence", [], "its convergence is damaged: a table is needed"),
    ],
)
def test_metadata_that_are_something_else_are_named(tmp_path: Path, key: str, value: Any, message: str) -> None:
    path = tmp_path / "result.parquet"
    save_trajectory(trajectory(), path)
    table = pq.read_table(path)
    metadata = table.schema.metadata | {f"fgpose.{key}".encode(): json.dumps(value).encode()}
    pq.write_table(table.replace_schema_metadata(metadata), path)
    with pytest.raises(ValueError, match=rf"result\.parquet: .*{message}"):
        load_trajectory(path)


def test_metadata_nested_deeply_are_an_error(tmp_path: Path) -> None:
    path = tmp_path / "result.parquet"
    save_trajectory(trajectory(), path)
    table = pq.read_table(path)
    metadata = table.schema.metadata | {b"fgpose.skeleton": b"[" * 100_000}
    pq.write_table(table.replace_schema_metadata(metadata), path)
    with pytest.raises(ValueError, match=r"result\.parquet: .*its skeleton is damaged: it is nested too deeply"):
        load_trajectory(path)


def test_what_another_version_says_of_the_convergence_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "result.parquet"
    save_trajectory(trajectory(), path)
    table = pq.read_table(path)
    metadata = table.schema.metadata | {b"fgpose.convergence": b'{"turns": 3}'}
    pq.write_table(table.replace_schema_metadata(metadata), path)
    with pytest.warns(UserWarning, match=r"convergence of another version .* turns"):
        loaded = load_trajectory(path)
    assert loaded.convergence is None
    np.testing.assert_array_equal(loaded.positions_m, trajectory().positions_m)


def test_two_columns_of_one_name_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "seen.parquet"
    save_observations(recording(), path)
    table = pq.read_table(path)
    pq.write_table(table.append_column("frame", table["frame"]), path)
    with pytest.raises(ValueError, match=r"seen\.parquet: two columns are named frame"):
        load_observations(path, rig(), STICK)


def test_a_column_of_cameras_that_is_none_takes_no_memory(tmp_path: Path) -> None:
    path = tmp_path / "seen.parquet"
    n_rows = 100_000
    columns = {name: np.zeros(n_rows) for name in ("time_s", "x_px", "y_px", "confidence")}
    names = [str(number) for number in range(n_rows)]
    columns |= {"frame": np.arange(n_rows), "camera": pa.array(names), "joint": pa.array(["neck"] * n_rows)}
    pq.write_table(pa.table(columns), path)
    with pytest.raises(ValueError, match=r"seen\.parquet: 100000 rows for 100000 frames, 100000 cameras"):
        load_observations(path, rig(), STICK)
