"""Trajectories and angles as tables and plots."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

import fgpose
from fgpose.kinematics.angles import JointAngles
from fgpose.trajectory import Status, Trajectory
from fgpose_benchmarks.synthetic import Scene

FRAMES = 60


@pytest.fixture(scope="module")
def walk(walking_scene: Scene) -> Trajectory:
    """With covariances of 4 cm^2, 9 cm^2 and 16 cm^2 along the axes, and a gap."""
    positions_m = walking_scene.truth_m.copy()
    status = np.full(positions_m.shape[:2], Status.OBSERVED)
    positions_m[5, 3], status[5, 3] = np.nan, Status.UNOBSERVABLE
    covariance_m2 = np.broadcast_to(np.diag([4e-4, 9e-4, 16e-4]), (*positions_m.shape[:2], 3, 3)).copy()
    return Trajectory(walking_scene.observations.skeleton, np.arange(FRAMES) / 30, positions_m, status, covariance_m2)


@pytest.fixture(scope="module")
def angles(walk: Trajectory) -> JointAngles:
    return fgpose.joint_angles(walk)


def test_a_long_table_has_the_columns_of_the_file(walk: Trajectory, tmp_path: Path) -> None:
    fgpose.save_trajectory(walk, tmp_path / "walk.parquet")
    table = walk.to_pandas()
    assert list(table) == pq.read_schema(tmp_path / "walk.parquet").names
    assert len(table) == FRAMES * walk.skeleton.n_joints
    wrist = table[table.joint == "left_wrist"]
    np.testing.assert_array_equal(wrist[["x_m", "y_m", "z_m"]], walk["left_wrist"])
    assert (table.cov_yy_m2 == 9e-4).sum() == len(table)
    gap = table[(table.frame == 5) & (table.joint == walk.skeleton.joints[3])].iloc[0]
    assert np.isnan(gap.x_m)
    assert gap.status == "unobservable"


def test_a_wide_table_has_a_row_for_each_frame(walk: Trajectory, angles: JointAngles) -> None:
    table = walk.to_pandas("wide")
    assert list(table)[:3] == ["frame", "time_s", "pelvis_x_m"]
    assert table.shape == (FRAMES, 2 + 6 * walk.skeleton.n_joints)
    np.testing.assert_array_equal(table["left_wrist_z_m"], walk["left_wrist"][:, 2])
    np.testing.assert_allclose(table["left_wrist_sigma_z_m"], 0.04)
    assert "pelvis_sigma_x_m" not in fgpose.Trajectory(
        walk.skeleton, walk.time_s, walk.positions_m, walk.status
    ).to_pandas("wide")
    knee = angles.to_pandas("wide")["left_knee_flexion_deg"]
    np.testing.assert_array_equal(knee, angles["left_knee_flexion"])


def test_angles_are_long_as_in_their_file(walk: Trajectory, angles: JointAngles, tmp_path: Path) -> None:
    fgpose.files.save_kinematics(walk, tmp_path / "angles.parquet", "z")
    whole: Any = pd.read_parquet(tmp_path / "angles.parquet")
    table = angles.to_pandas()
    assert list(table) == list(whole)
    of_angles = whole[whole.kind == "angle"].reset_index(drop=True)
    pd.testing.assert_frame_equal(table, of_angles, check_categorical=False, check_dtype=False)


def test_speeds_are_those_of_the_file(walk: Trajectory, tmp_path: Path) -> None:
    fgpose.files.save_kinematics(walk, tmp_path / "angles.parquet", "z")
    whole: Any = pd.read_parquet(tmp_path / "angles.parquet")
    speeds = fgpose.kinematics.joint_speeds(walk)
    of_speeds = whole[whole.kind == "speed"].reset_index(drop=True)
    pd.testing.assert_frame_equal(speeds.to_pandas(), of_speeds, check_categorical=False, check_dtype=False)
    wide = speeds[2:9].to_pandas("wide")
    assert list(wide)[:3] == ["frame", "time_s", "pelvis_speed_m_s"]
    assert wide.shape == (7, 2 + walk.skeleton.n_joints + 1)
    np.testing.assert_array_equal(wide["centre_speed_m_s"], speeds["centre"][2:9])


@pytest.mark.parametrize("form", ["long", "wide"])
def test_csv_reads_back_as_the_same_numbers(walk: Trajectory, angles: JointAngles, form: str, tmp_path: Path) -> None:
    for shown in (walk, angles, fgpose.kinematics.joint_speeds(walk)):
        shown.to_csv(tmp_path / "table.csv", form)  # pyrefly: ignore[bad-argument-type]
        wanted = shown.to_pandas(form)  # pyrefly: ignore[bad-argument-type]
        found = pd.read_csv(tmp_path / "table.csv")
        assert list(found) == list(wanted)
        for name in wanted:
            if wanted[name].dtype.kind in "fi":
                np.testing.assert_array_equal(found[name].astype(float), wanted[name].astype(float))
            else:
                assert list(found[name]) == list(wanted[name].astype(str))


def test_a_form_that_is_none_is_refused(walk: Trajectory) -> None:
    from fgpose.io.trajectories import over_time

    unchecked: Any = over_time.table_over_time
    with pytest.raises(ValueError, match="a table is long or wide, not 'tall'"):
        getattr(unchecked, "__wrapped__", unchecked)(walk, "tall")


def test_what_is_not_installed_is_named(walk: Trajectory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError, match=r'to_pandas\(\) needs pandas: pip install "fgpose\[notebook\]"'):
        walk.to_pandas()
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(ImportError, match=r'plot\(\) needs matplotlib: pip install "fgpose\[notebook\]"'):
        walk.plot("left_wrist")


@pytest.fixture
def without_window() -> None:
    mpl.use("Agg")


@pytest.mark.usefixtures("without_window")
def test_joints_are_plotted_with_two_sigma(walk: Trajectory, angles: JointAngles) -> None:
    from matplotlib import pyplot

    axes = walk.plot(["left_wrist", "right_wrist"])
    assert [panel.get_ylabel() for panel in axes] == ["x [m]", "y [m]", "z [m]"]
    for axis, (panel, sigma_m) in enumerate(zip(axes, (0.02, 0.03, 0.04), strict=True)):
        left = panel.get_lines()[0]
        np.testing.assert_array_equal(left.get_ydata(), walk["left_wrist"][:, axis])
        band = panel.collections[0].get_paths()[0].vertices
        low_m, high_m = band[:, 1].min(), band[:, 1].max()
        np.testing.assert_allclose(low_m, walk["left_wrist"][:, axis].min() - 2 * sigma_m)
        np.testing.assert_allclose(high_m, walk["left_wrist"][:, axis].max() + 2 * sigma_m)
    (panel,) = angles.plot("left_knee_flexion")
    np.testing.assert_array_equal(panel.get_lines()[0].get_ydata(), angles["left_knee_flexion"])
    for shown in (walk, angles):
        with pytest.raises(ValueError, match=r"no .* 'left_wirst'"):
            shown.plot("left_wirst")
    (panel,) = fgpose.kinematics.joint_speeds(walk).plot(["left_wrist", "centre"])
    assert panel.get_ylabel() == "speed [m/s]"
    pyplot.close("all")
