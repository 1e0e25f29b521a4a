"""What the numbers in a C3D file can count, and what is done beyond; read by ezc3d, which knows nothing of fgpose."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_files import walk

from fgpose.cli import main
from fgpose.io.skeletons import load_skeleton
from fgpose.io.trajectories import c3d, load_trajectory, save_trajectory
from fgpose.io.trajectories.kinematics import save_kinematics
from fgpose.kinematics.poses import segment_poses
from fgpose.trajectory import Status, Trajectory

ezc3d = pytest.importorskip("ezc3d")
N_JOINTS = walk().skeleton.n_joints


def test_rotations_that_the_file_cannot_point_to_are_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "walk.c3d"
    n_bytes = walk().n_frames * N_JOINTS * 16
    monkeypatch.setattr(c3d, "_MOST_POINT_BYTES", n_bytes)
    save_kinematics(walk(), path, "z")
    assert ezc3d.c3d(str(path))["data"]["rotations"].shape[2] > 0
    monkeypatch.setattr(c3d, "_MOST_POINT_BYTES", n_bytes - 1)
    with pytest.warns(UserWarning, match=r"walk\.c3d: it has points and no rotations: .* Write .* \.bvh, \.mot"):
        save_kinematics(walk(), path, "z")
    file = ezc3d.c3d(str(path))
    assert file["data"]["rotations"].size == 0
    assert file["data"]["points"].shape[1:] == (N_JOINTS, walk().n_frames)
    assert load_trajectory(path, world_up="z", file_up="z").n_frames == walk().n_frames


@pytest.mark.slow
@pytest.mark.parametrize("too_many", [False, True])
def test_rotations_are_right_up_to_where_they_are_left_out(tmp_path: Path, *, too_many: bool) -> None:
    """Behind 16.7 MB of points the number of their block is above 32767, and they were read as points."""
    path, skeleton = tmp_path / "long.c3d", load_skeleton("halpe_136")
    n_frames = c3d._MOST_POINT_BYTES // (16 * skeleton.n_joints) + too_many
    positions_m = np.random.default_rng(0).normal(size=(n_frames, skeleton.n_joints, 3))
    status = np.full(positions_m.shape[:2], Status.OBSERVED)
    long = Trajectory(skeleton, np.arange(n_frames) / 50, positions_m, status)
    if too_many:
        with pytest.warns(UserWarning, match="it has points and no rotations"):
            save_kinematics(long, path, "z")
        assert not ezc3d.c3d(str(path))["data"]["rotations"].size
        return
    save_kinematics(long, path, "z")
    found = ezc3d.c3d(str(path))["data"]["rotations"]
    assert found.shape[3] == n_frames
    poses = segment_poses(long, "z")
    expected = np.where(poses.determined[..., None, None], poses.world_R_segment, np.nan).transpose(2, 3, 1, 0)
    np.testing.assert_allclose(found[:3, :3], expected, atol=2**-23)  # 32-bit numbers of up to 1


@pytest.mark.parametrize("n_markers", [255, 256, 600])
def test_markers_beyond_255_have_their_names(tmp_path: Path, n_markers: int) -> None:
    """A parameter of a C3D file holds 255 names; ezc3d puts the others into LABELS2 and LABELS3."""
    other = ezc3d.c3d()
    names = tuple(f"M{number}" for number in range(n_markers))
    other["data"]["points"] = np.broadcast_to(np.arange(1.0, n_markers + 1)[:, None], (4, n_markers, 3)).copy()
    parameters = other["parameters"]["POINT"]
    parameters["RATE"]["value"], parameters["UNITS"]["value"], parameters["LABELS"]["value"] = [50.0], ["mm"], names
    other.write(str(tmp_path / "other.c3d"))
    read = load_trajectory(tmp_path / "other.c3d")
    assert read.skeleton.joints == names
    np.testing.assert_allclose(read["M254"], 0.255)
    np.testing.assert_allclose(read[names[-1]], n_markers / 1000)
    save_trajectory(read, tmp_path / "own.c3d", "z")
    assert load_trajectory(tmp_path / "own.c3d").skeleton.joints == names


@pytest.mark.parametrize("start_s", [-3.2, 1e5, 1.7e9 + 0.123])
def test_a_start_that_the_number_of_a_frame_cannot_tell_comes_back(tmp_path: Path, start_s: float) -> None:
    path, early = tmp_path / "walk.c3d", replace(walk(), time_s=walk().time_s + start_s)
    with pytest.warns(UserWarning, match=r"walk\.c3d: C3D cannot hold a start at .* starts at 0 s"):
        save_trajectory(early, path, "z")
    # Times since 1970 are numbers that differ by 2.4e-7 s.
    np.testing.assert_allclose(load_trajectory(path, file_up="z").time_s, early.time_s, rtol=0, atol=5e-7)
    assert ezc3d.c3d(str(path))["header"]["points"]["first_frame"] == 0


def test_frames_that_are_missing_are_gaps_of_all_points(tmp_path: Path) -> None:
    """Nobody was there for more than three seconds."""
    path, n_frames = tmp_path / "walk.c3d", 8
    positions_m = np.concatenate([walk().positions_m] * 2)
    number = np.arange(n_frames) + 90 * (np.arange(n_frames) >= 5)
    time_s = 2.0 + number / 25
    absent = Trajectory(walk().skeleton, time_s, positions_m, np.full(positions_m.shape[:2], Status.OBSERVED))
    save_kinematics(absent, path, "z")
    file = ezc3d.c3d(str(path))
    missing = file["data"]["meta_points"]["residuals"][0] < 0
    assert missing.shape == (N_JOINTS, n_frames + 90)
    np.testing.assert_array_equal(np.flatnonzero(~missing.all(axis=0)), number)
    np.testing.assert_allclose(file["data"]["points"][:3, 0, number].T, 1000 * positions_m[:, 0], rtol=2**-24)
    rotations = file["data"]["rotations"]
    np.testing.assert_array_equal(np.flatnonzero(np.isfinite(rotations[0, 0, 0])), number)
    read = load_trajectory(path, file_up="z")
    np.testing.assert_allclose(read.time_s[~read.absent], time_s, rtol=2**-23)  # the rate has 32 bit


def test_gaps_of_more_frames_than_a_file_holds_are_closed(tmp_path: Path) -> None:
    steps_s = np.array([0.0, 0.02, 0.04, 1e4])
    with pytest.warns(
        UserWarning, match=r"constant frame rate, 50 Hz .* frame 3 is 1e\+07 ms later than the file says"
    ):
        save_trajectory(replace(walk(), time_s=steps_s), tmp_path / "walk.c3d", "z")
    assert load_trajectory(tmp_path / "walk.c3d", file_up="z").n_frames == 4


def test_angles_of_too_many_frames_are_refused_before_any_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    save_trajectory(walk(), tmp_path / "walk.npz")
    monkeypatch.setattr(c3d, "_MAX_FRAMES", walk().n_frames - 1)
    outputs = [str(tmp_path / f"angles.{extension}") for extension in ("mot", "c3d")]
    assert main(["angles", str(tmp_path / "walk.npz"), "-o", outputs[0], "-o", outputs[1]]) == 2
    printed = capsys.readouterr()
    assert "angles.c3d: C3D holds at most 3 frames, this is 4" in printed.err
    assert not printed.out
    assert [path.name for path in tmp_path.iterdir()] == ["walk.npz"]
