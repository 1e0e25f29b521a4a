"""The page of columns, which is made of what the code says, says what is in the files, and nothing else."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable, Mapping
from dataclasses import fields, replace
from functools import cache
from importlib import import_module
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

import fgpose
from fgpose.geometry.camera import CameraRig
from fgpose.io.calibration import save_rig as save_calibration
from fgpose.io.origin import CalibrationOrigin
from fgpose.io.studies.events import Event
from fgpose.io.studies.results import write_part
from fgpose.io.tables import Column
from fgpose.io.trajectories.npz import write_npz as save_npz
from fgpose.people import PeopleObservations
from fgpose.report.quality import Quality
from fgpose.study.events import events_of
from fgpose.study.run import Tables
from fgpose.study.trial import Trial

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "columns.md"
RESULTS, WIDE = "Results: `NAME.parquet`, `NAME.csv`", 'Wide results: `trajectory.to_csv(path, "wide")`'
ANGLES = "Joint angles, speeds, heights: `angles.parquet`, `angles.csv`"
WIDE_ANGLES = 'Wide angles: `joint_angles(trajectory).to_csv(path, "wide")`'
WIDE_SPEEDS = 'Wide speeds: `joint_speeds(trajectory).to_csv(path, "wide")`'
ONE = "Detections of one person: `fgpose.files.save_observations`"
EVERYBODY = "Detections of everybody: `fgpose detect`"
NPZ = {
    "result": "Results as arrays: `NAME.npz`",
    "one": "Detections of one person as arrays: `fgpose.files.save_observations`",
    "everybody": "Detections of everybody as arrays: `fgpose detect --formats npz`",
    "rig": "Calibration as arrays: `fgpose.save_rig`",
}


@cache
def tables() -> dict[str, tuple[Column, ...]]:
    """Those that the page shows, by the heading."""
    found = {}
    for section in PAGE.read_text(encoding="utf-8").split("\n## ")[1:]:
        (module, name) = re.findall(r"```{columns} ([\w.]+)\.(\w+)\n```", section)[0]
        found[section.splitlines()[0]] = getattr(import_module(module), name)
    return found


@cache
def described() -> dict[str, list[str]]:
    """The columns of each table, in order, by the heading."""
    return {
        heading: [name for column in columns for name in column.names.split()] for heading, columns in tables().items()
    }


def test_the_page_shows_names_units_and_meanings(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(PAGE.parents[1] / "extensions"))
    markdown = import_module("columns").markdown
    assert markdown([Column("x_m y_m", "m", "position"), Column("joint", "", "its name")]) == (
        "| column | unit | meaning |\n| --- | --- | --- |\n| `x_m`, `y_m` | m | position |\n| `joint` |  | its name |"
    )
    assert "| `joints` |  | (J,) | their names |" in markdown([Column("joints", "", "their names", "(J,)")])
    assert all(column.meaning for columns in tables().values() for column in columns)


def check(heading: str, columns: Iterable[str]) -> None:
    """That each column is described, and each description has a column; those with names of their own in this order."""
    names, columns = described()[heading], list(columns)
    patterns = {name: re.compile(re.sub(r"<\w+>", ".+", name)) for name in names}
    assert [each for each in columns if not any(pattern.fullmatch(each) for pattern in patterns.values())] == []
    assert [name for name, pattern in patterns.items() if not any(map(pattern.fullmatch, columns))] == []
    fixed = [name for name in names if "<" not in name]
    assert [each for each in columns if each in fixed] == fixed


@pytest.fixture(scope="module")
def observations() -> fgpose.Observations:
    """With all that there may be: per-view 3D and its covariance."""
    _, observations = fgpose.files.load_recording("balance_blazepose")
    some = observations.frames(slice(0, 4))
    assert some.points3d_m is not None
    return replace(some, covariance3d_m2=np.broadcast_to(np.eye(3) * 1e-2, (*some.points3d_m.shape, 3)))


@pytest.fixture(scope="module")
def trajectory(observations: fgpose.Observations) -> fgpose.Trajectory:
    rig, _ = fgpose.files.load_recording("balance_blazepose")
    return fgpose.smooth(observations, rig)


def header(path: Path) -> list[str]:
    return pq.read_schema(path).names if path.suffix == ".parquet" else list(map(str, pd.read_csv(path, nrows=0)))


@pytest.mark.parametrize("extension", [".parquet", ".csv"])
def test_the_columns_of_results_and_angles(trajectory: fgpose.Trajectory, extension: str, tmp_path: Path) -> None:
    result, angles = tmp_path / f"result{extension}", tmp_path / f"angles{extension}"
    fgpose.save_trajectory(trajectory, result)
    check(RESULTS, header(result))
    fgpose.files.save_kinematics(trajectory, angles, "z")
    check(ANGLES, header(angles))
    if extension == ".parquet":
        for path, heading in ((result, RESULTS), (angles, ANGLES)):
            write_part(path, tmp_path / "part.parquet", "S01/a/walk", "walk", "")
            of_part = header(tmp_path / "part.parquet")
            assert of_part[:2] == described()["Studies"]
            assert of_part[2:] == [name for name in described()[heading] if "<" not in name]


def test_the_columns_of_wide_tables(trajectory: fgpose.Trajectory, tmp_path: Path) -> None:
    trajectory.to_csv(tmp_path / "wide.csv", "wide")
    check(WIDE, header(tmp_path / "wide.csv"))
    fgpose.joint_angles(trajectory).to_csv(tmp_path / "angles.csv", "wide")
    check(WIDE_ANGLES, header(tmp_path / "angles.csv"))
    fgpose.kinematics.joint_speeds(trajectory).to_csv(tmp_path / "speeds.csv", "wide")
    check(WIDE_SPEEDS, header(tmp_path / "speeds.csv"))


def test_the_columns_of_detections(observations: fgpose.Observations, tmp_path: Path) -> None:
    fgpose.files.save_observations(observations, tmp_path / "one.parquet")
    check(ONE, header(tmp_path / "one.parquet"))
    fgpose.files.save_people_observations(PeopleObservations.of_one(observations), tmp_path / "everybody.parquet")
    check(EVERYBODY, header(tmp_path / "everybody.parquet"))


def test_the_arrays_of_npz_files(
    observations: fgpose.Observations, trajectory: fgpose.Trajectory, tmp_path: Path
) -> None:
    """Each array is described, with its unit and its shape."""
    rig, _ = fgpose.files.load_recording("balance_blazepose")
    first, *others = rig.cameras
    pose = (3.0, first.world_T_camera)
    changing = replace(first, clock_drift=1e-5, clock_jumps=((2.0, 0.1),), moves=(pose,))
    known = CalibrationOrigin({first.name: 0.001})
    everybody = PeopleObservations.of_one(observations)
    implausible = replace(trajectory, implausible_frames=(1,), frame_numbers=np.arange(trajectory.n_frames))
    save_npz(implausible, tmp_path / "result.npz", "fgpose smooth walk.npz")
    fgpose.files.save_observations(observations, tmp_path / "one.npz")
    fgpose.files.save_people_observations(everybody, tmp_path / "everybody.npz")
    save_calibration(CameraRig((changing, *others)), tmp_path / "rig.npz", origin=known)
    sizes = {
        "T": observations.n_frames,
        "C": observations.n_cameras,
        "J": observations.skeleton.n_joints,
        "I": len(everybody.images),
        "N": sum(image.n_people for image in everybody.images),
        "rows": 1,
    }
    for name, heading in NPZ.items():
        with np.load(tmp_path / f"{name}.npz", allow_pickle=False) as arrays:
            assert set(arrays) == set(described()[heading])
            for array, shapes in shapes_of(heading).items():
                given = "text" if arrays[array].ndim == 0 else arrays[array].shape
                assert given in [_shape(shape, sizes) for shape in shapes.split(" or ")], (name, array)


def shapes_of(heading: str) -> dict[str, str]:
    """By the name of the array."""
    return {column.names: column.shape for column in tables()[heading]}


def _shape(text: str, sizes: Mapping[str, int]) -> str | tuple[int, ...]:
    if text == "text":
        return text
    return tuple(sizes[part] if part in sizes else int(part) for part in re.findall(r"\w+", text))


def test_the_columns_of_events() -> None:
    event = Event("fall", 1.5, {"subject": "S01"}, {"severity": "low"})
    rows, _ = events_of([Trial("S01", "a", "walk", Path("walk.npz"), "keypoints")], [event])
    check("Events of a study: `events.parquet`", rows[0])


def test_the_columns_of_files_for_opensim(trajectory: fgpose.Trajectory, tmp_path: Path) -> None:
    fgpose.files.save_kinematics(trajectory, tmp_path / "walk.mot", "z")
    lines = (tmp_path / "walk.mot").read_text().splitlines()
    check("Coordinates of OpenSim: `NAME.mot`", lines[lines.index("endheader") + 1].split("\t"))
    fgpose.save_trajectory(trajectory, tmp_path / "walk.trc", "z")
    names = (tmp_path / "walk.trc").read_text().splitlines()[3].split("\t")
    check("Markers: `NAME.trc`", filter(None, names))
    assert len(names) == 2 + 3 * trajectory.skeleton.n_joints
    assert np.isfinite(trajectory.positions_m).any()


def test_the_columns_of_quality() -> None:
    """Those of a row of a recording that is done; what is of the table itself stands in its code."""
    of_row = inspect.getsource(Tables.add)
    of_table = set(re.findall(r'"(\w+)": ', of_row)) | set(re.findall(r'row\["(\w+)"\]', of_row))
    numbers = {field.name for field in fields(Quality)} - {"name", "unknown"} | {"n_suspicions"}
    assert set(described()["Quality of a study: `quality.csv`, `quality.parquet`"]) == of_table | numbers
