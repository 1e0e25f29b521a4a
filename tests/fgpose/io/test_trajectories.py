from __future__ import annotations

import dataclasses
import math
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from small_files import assert_same

from fgpose.config import Config, MotionConfig, OnlineConfig
from fgpose.io.atomic import check_writable
from fgpose.io.skeletons import builtin_skeletons, load_skeleton
from fgpose.io.trajectories import EXTENSIONS, check_output, load_trajectory, save_trajectory
from fgpose.trajectory import Convergence, Status, Trajectory

REAL_TRC = Path(__file__).parents[2] / "data" / "trc" / "S00_P00_T01_BalancingTrial_0-20.trc"
CAMERAS = ("left", "right", "top view")


@pytest.fixture
def trajectory() -> Trajectory:
    """Five frames at 50 Hz with a gap, everything known that can be."""
    rng = np.random.default_rng(0)
    skeleton = load_skeleton("halpe_26")
    n_frames, n_joints = 5, skeleton.n_joints
    positions_m = rng.normal(size=(n_frames, n_joints, 3))
    status = rng.choice([Status.PREDICTED, Status.OBSERVED], size=(n_frames, n_joints)).astype(int)
    factors_m = rng.normal(size=(n_frames, n_joints, 3, 3)) / 100
    covariance_m2 = factors_m @ factors_m.swapaxes(-1, -2)
    # The product is symmetric but for rounding; Parquet keeps one triangle.
    covariance_m2 = (covariance_m2 + covariance_m2.swapaxes(-1, -2)) / 2
    residual_px = rng.uniform(0, 10, size=(n_frames, len(CAMERAS), n_joints))
    residual_px[1, :, 4] = np.nan
    residual_px[2, 0] = np.nan
    positions_m[1, 4], covariance_m2[1, 4], status[1, 4] = np.nan, np.nan, Status.UNOBSERVABLE
    positions_m[3, -1], status[3, -1] = np.nan, Status.UNOBSERVABLE
    lengths_m = rng.uniform(0.1, 0.5, size=skeleton.n_lengths)
    lengths_m[2] = np.nan
    return Trajectory(
        skeleton=skeleton,
        time_s=2.0 + np.arange(n_frames) / 50,
        positions_m=positions_m,
        status=status,
        covariance_m2=covariance_m2,
        residual_px=residual_px,
        camera_names=CAMERAS,
        bone_lengths_m=lengths_m,
        bone_length_sigma_m=lengths_m / 50,
        convergence=Convergence(converged=True, iterations=7, initial_error=1 / 3, final_error=0.1),
        config=Config(motion=MotionConfig(model="random_walk"), online=OnlineConfig(lag_s=math.inf)),
        visibility=np.where(np.isnan(residual_px), np.nan, rng.uniform(size=residual_px.shape)),
    )


@pytest.fixture
def bare(trajectory: Trajectory) -> Trajectory:
    """Positions alone."""
    return Trajectory(trajectory.skeleton, trajectory.time_s, trajectory.positions_m, trajectory.status)


@pytest.mark.parametrize("extension", [".parquet", ".npz"])
def test_everything_survives_a_round_trip_exactly(trajectory, bare, tmp_path, extension):
    for each in (trajectory, bare):
        save_trajectory(each, tmp_path / f"result{extension}")
        assert_same(load_trajectory(tmp_path / f"result{extension}"), each)


@pytest.mark.parametrize("extension", [".parquet", ".npz"])
@pytest.mark.parametrize("name", builtin_skeletons())
def test_every_builtin_skeleton_survives_a_round_trip(tmp_path, extension, name):
    skeleton = load_skeleton(name)
    positions_m = np.zeros((1, skeleton.n_joints, 3))
    status = np.full((1, skeleton.n_joints), Status.OBSERVED)
    path = tmp_path / f"result{extension}"
    save_trajectory(Trajectory(skeleton, np.zeros(1), positions_m, status), path)
    assert load_trajectory(path).skeleton == skeleton


def test_content_not_extension_says_how_a_file_is_read(trajectory, tmp_path):
    save_trajectory(trajectory, tmp_path / "result.npz")
    (tmp_path / "result.npz").rename(tmp_path / "result.parquet")
    assert_same(load_trajectory(tmp_path / "result.parquet"), trajectory)


def test_parquet_is_a_long_table_that_needs_no_fgpose(trajectory, tmp_path):
    save_trajectory(trajectory, tmp_path / "result.parquet")
    table = pq.read_table(tmp_path / "result.parquet")
    assert table.column_names == [
        *("time_s", "frame", "person", "joint", "x_m", "y_m", "z_m"),
        *("cov_xx_m2", "cov_xy_m2", "cov_xz_m2", "cov_yy_m2", "cov_yz_m2", "cov_zz_m2", "n_views", "reprojection_px"),
        *(f"residual_px_{camera}" for camera in CAMERAS),
        *(f"visibility_{camera}" for camera in CAMERAS),
        "status",
    ]
    rows = table.to_pylist()
    row, gap = rows[2 * 26 + 3], rows[1 * 26 + 4]
    assert (row["frame"], row["person"], row["joint"]) == (2, 0, "left_ear")
    assert row["y_m"] == trajectory.positions_m[2, 3, 1]
    assert row["cov_xz_m2"] == trajectory.covariance_m2[2, 3, 0, 2]
    assert row["n_views"] == 2
    assert row[f"visibility_{CAMERAS[1]}"] == trajectory.visibility[2, 1, 3]
    assert row["reprojection_px"] == trajectory.residual_px[2, 1:, 3].mean()
    assert (gap["x_m"], gap["cov_yy_m2"], gap["n_views"], gap["status"]) == (None, None, 0, "unobservable")
    assert gap["reprojection_px"] is None


def test_parquet_with_rows_missing_is_refused(trajectory, tmp_path):
    path = tmp_path / "result.parquet"
    save_trajectory(trajectory, path)
    pq.write_table(pq.read_table(path).slice(1), path)
    with pytest.raises(ValueError, match=r"result\.parquet.*rows are missing"):
        load_trajectory(path)


def test_parquet_of_others_is_refused(tmp_path):
    pq.write_table(pa.table({"x": [1.0]}), tmp_path / "other.parquet")
    with pytest.raises(ValueError, match=r"other\.parquet.*not written by fgpose"):
        load_trajectory(tmp_path / "other.parquet")


def test_npz_needs_no_pickle_and_says_what_its_numbers_mean(trajectory, tmp_path):
    save_trajectory(trajectory, tmp_path / "result.npz")
    with np.load(tmp_path / "result.npz", allow_pickle=False) as archive:
        assert {name: archive[name].dtype.kind for name in archive.files}["config"] == "U"
        assert archive["status_names"][archive["status"][1, 4]] == "unobservable"
        assert archive["joints"].tolist() == list(trajectory.skeleton.joints)


def test_config_of_another_version_does_not_make_a_result_unreadable(trajectory, tmp_path):
    path = tmp_path / "result.npz"
    save_trajectory(trajectory, path)
    with np.load(path) as archive:
        arrays: dict[str, Any] = dict(archive) | {"config": np.array("[motion]\nold_name = 1.0\n")}
    np.savez(path, **arrays)
    with pytest.warns(UserWarning, match="old_name"):
        loaded = load_trajectory(path)
    assert loaded.config is None
    np.testing.assert_array_equal(loaded.positions_m, trajectory.positions_m)


def test_joints_come_in_the_order_of_the_skeleton_asked_for(trajectory, tmp_path):
    save_trajectory(trajectory, tmp_path / "result.npz")
    wanted = load_skeleton("body_25")
    loaded = load_trajectory(tmp_path / "result.npz", wanted)
    assert loaded.skeleton == wanted
    ours, theirs = wanted.index("left_knee"), trajectory.skeleton.index("left_knee")
    np.testing.assert_array_equal(loaded.positions_m[:, ours], trajectory.positions_m[:, theirs])
    assert loaded.covariance_m2 is not None
    assert loaded.residual_px is not None
    np.testing.assert_array_equal(loaded.covariance_m2[:, ours], trajectory.covariance_m2[:, theirs])
    np.testing.assert_array_equal(loaded.residual_px[..., ours], trajectory.residual_px[..., theirs])
    assert loaded.visibility is not None
    np.testing.assert_array_equal(loaded.visibility[..., ours], trajectory.visibility[..., theirs])
    assert (loaded.bone_lengths_m, loaded.bone_length_sigma_m) == (None, None)


def test_joints_that_the_file_lacks_are_unobservable(tmp_path):
    skeleton = load_skeleton("body_25b")
    loaded = load_trajectory(REAL_TRC, skeleton)
    eye, knee = skeleton.index("left_eye"), skeleton.index("left_knee")
    assert np.isnan(loaded.positions_m[:, eye]).all()
    assert (loaded.status[:, eye] == Status.UNOBSERVABLE).all()
    assert (loaded.status[:, knee] == Status.OBSERVED).all()


def test_a_skeleton_without_a_joint_of_the_file_is_refused(tmp_path):
    skeleton = dataclasses.replace(load_skeleton("h36m_17"), joints=tuple(f"joint_{j}" for j in range(17)))
    with pytest.raises(ValueError, match=r"0-20\.trc.*no joint of skeleton h36m_17.*right_hip"):
        load_trajectory(REAL_TRC, skeleton)


def test_c3d_without_ezc3d_says_how_to_get_it(bare, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "ezc3d", None)
    for attempt in (lambda path: save_trajectory(bare, path), check_output):
        with pytest.raises(ImportError, match=r'pip install "fgpose\[c3d\]"'):
            attempt(tmp_path / "result.c3d")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_is_made_and_one_that_cannot_be_is_named(bare, tmp_path):
    check_writable(tmp_path / "new" / "folder")
    assert list((tmp_path / "new" / "folder").iterdir()) == []
    (tmp_path / "file").write_text("")
    for attempt in (check_output, lambda path: save_trajectory(bare, path)):
        with pytest.raises(OSError, match=r"cannot write results into .*file"):
            attempt(tmp_path / "file" / "result.npz")


@pytest.mark.parametrize("name", ["result.xlsx", "result"])
def test_an_unknown_extension_is_refused(bare, tmp_path, name):
    for attempt in (check_output, lambda path: save_trajectory(bare, path)):
        with pytest.raises(
            ValueError, match=rf"{name}: a trajectory is written as \.parquet, \.npz, \.csv, \.trc, \.c3d"
        ):
            attempt(tmp_path / name)


@pytest.mark.parametrize("extension", EXTENSIONS)
def test_an_empty_or_foreign_file_is_named(tmp_path, extension):
    path = tmp_path / f"result{extension}"
    path.write_bytes(b"")
    with pytest.raises(ValueError, match=rf"result\{extension}: the file is empty"):
        load_trajectory(path)
    path.write_bytes(b"something else altogether")
    with pytest.raises(ValueError, match=rf"result\{extension}: not a trajectory"):
        load_trajectory(path)


def test_an_archive_of_something_else_is_named(tmp_path):
    np.savez(tmp_path / "rig.npz", K=np.eye(3))
    with zipfile.ZipFile(tmp_path / "texts.npz", "w") as archive:
        archive.writestr("readme.txt", "hello")
    for name in ("rig.npz", "texts.npz"):
        with pytest.raises(ValueError, match=rf"{name}: not a readable npz .*skeleton and camera_names are missing"):
            load_trajectory(tmp_path / name)


@pytest.mark.parametrize("extension", [".npz", ".trc"])
def test_times_that_do_not_increase_are_refused_by_name(extension: str, trajectory: Trajectory, tmp_path: Path) -> None:
    """As of a column that somebody stored as whole seconds."""
    path = tmp_path / f"walk{extension}"
    save_trajectory(trajectory, path)
    if extension == ".npz":
        arrays = dict(np.load(path))
        np.savez(path, **{**arrays, "time_s": arrays["time_s"].astype(int)})
    else:
        lines = path.read_text().splitlines()
        path.write_text("\n".join([*lines, lines[-1]]))
    with pytest.raises(ValueError, match=rf"walk\{extension}: .*times do not increase: frame \d"):
        load_trajectory(path)
