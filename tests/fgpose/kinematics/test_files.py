from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from built_body import built, random_angles, trajectory
from bvh_reader import places, read_bvh
from mot_files import read_mot

from fgpose.cli import main
from fgpose.io.skeletons import load_skeleton
from fgpose.io.trajectories import load_trajectory, save_people, save_trajectory
from fgpose.io.trajectories.c3d import read_c3d, write_c3d
from fgpose.io.trajectories.kinematics import load_angles, save_kinematics
from fgpose.kinematics.angles import joint_angles
from fgpose.kinematics.opensim import opensim_coordinates
from fgpose.kinematics.poses import segment_poses
from fgpose.trajectory import Trajectory
from fgpose_benchmarks.synthetic import embedded_motion, walking

H36M = load_skeleton("h36m_17")
JOINT_OF_NODE = {
    "Hips": None,
    "LeftUpLeg": "left_hip",
    "LeftLeg": "left_knee",
    "LeftLegEnd": "left_ankle",
    "RightUpLeg": "right_hip",
    "RightLeg": "right_knee",
    "RightLegEnd": "right_ankle",
    "LeftArm": "left_shoulder",
    "LeftForeArm": "left_elbow",
    "LeftForeArmEnd": "left_wrist",
    "RightArm": "right_shoulder",
    "RightForeArm": "right_elbow",
    "RightForeArmEnd": "right_wrist",
    "NeckEnd": "head",
}


@pytest.fixture
def walk() -> Trajectory:
    """The walker, with a covariance, a gap of one knee, and nobody in the first frame."""
    positions_m = walking(40, 50.0)
    positions_m[20, H36M.index("left_knee")] = np.nan
    positions_m[0] = np.nan
    covariance_m2 = np.broadcast_to(np.diag([1e-4, 2e-4, 3e-4]), (*positions_m.shape[:2], 3, 3))
    covariance_m2 = np.where(np.isnan(positions_m)[..., None], np.nan, covariance_m2)
    return trajectory(positions_m, H36M, covariance_m2)


def test_parquet_holds_everything_with_units(walk: Trajectory, tmp_path: Path) -> None:
    import pyarrow.parquet as pq

    save_kinematics(walk, tmp_path / "walk.parquet")
    table = pq.read_table(tmp_path / "walk.parquet")
    assert json.loads(table.schema.metadata[b"fgpose.units"]) == {"angle": "deg", "speed": "m/s", "height": "m"}
    rows = table.to_pylist()
    assert len(rows) == 40 * (22 + 2 * 18)
    row = next(r for r in rows if r["frame"] == 5 and r["kind"] == "height" and r["name"] == "left_wrist")
    wrist = H36M.index("left_wrist")
    assert row == {
        "time_s": walk.time_s[5],
        "frame": 5,
        "person": 0,
        "kind": "height",
        "name": "left_wrist",
        "value": walk.positions_m[5, wrist, 2],
        "sigma": np.sqrt(3e-4),
        "unit": "m",
    }
    speeds = [r for r in rows if r["kind"] == "speed" and r["name"] == "centre"]
    assert [r["value"] is None for r in speeds[:3]] == [True, True, False]  # beside a frame with nobody
    assert all(r["sigma"] is None for r in speeds)


def test_angles_come_back_from_parquet(walk: Trajectory, tmp_path: Path) -> None:
    expected = joint_angles(walk)
    save_kinematics({2: walk, 5: walk}, tmp_path / "walk.parquet")
    found = load_angles(tmp_path / "walk.parquet")
    assert list(found) == [2, 5]
    for angles in found.values():
        assert angles.names == expected.names
        for name in ("time_s", "angle_deg", "sigma_deg"):
            np.testing.assert_array_equal(getattr(angles, name), getattr(expected, name))


def test_another_parquet_is_refused(walk: Trajectory, tmp_path: Path) -> None:
    save_trajectory(walk, tmp_path / "walk.parquet")
    with pytest.raises(ValueError, match=r"walk\.parquet: not readable joint angles: it was not written by"):
        load_angles(tmp_path / "walk.parquet")


def test_mot_is_what_opensim_reads(walk: Trajectory, tmp_path: Path) -> None:
    path = tmp_path / "walk.mot"
    save_kinematics(walk, path)
    lines = path.read_text().splitlines()
    # OpenSim's Storage: the name, version, nRows, nColumns, inDegrees, then anything up to endheader.
    assert lines[:5] == ["Coordinates", "version=1", "nRows=40", "nColumns=24", "inDegrees=yes"]
    table = lines[lines.index("endheader") + 1 :]
    assert table[0].split("\t")[:2] == ["time", "pelvis_tilt"]
    assert {len(line.split("\t")) for line in table} == {24}
    found, time_s = read_mot(path)
    expected = opensim_coordinates(walk)
    np.testing.assert_array_equal(time_s, walk.time_s)
    # The walker's elbows are always straight.
    assert expected.keys() - found.keys() == {"arm_rot_r", "arm_rot_l"}
    for name, values in found.items():
        known = np.isfinite(expected[name])
        np.testing.assert_array_equal(values[known], expected[name][known])


def joint_errors_m(walk: Trajectory, path: Path) -> dict[str, np.ndarray]:
    """Distance of every joint from where the forward kinematics of a BVH file put it."""
    nodes, frame_time_s, values = read_bvh(path)
    assert frame_time_s == pytest.approx(0.02)
    found = places(nodes, values)
    errors = {}
    for node, joint in JOINT_OF_NODE.items():
        if joint is not None:
            true_m = walk[joint][:, [1, 2, 0]]  # y up
            errors[joint] = np.linalg.norm(found[node] - true_m, axis=1)
    return errors


def test_forward_kinematics_of_bvh_return_to_the_joints_of_a_rigid_body(tmp_path: Path) -> None:
    whole = trajectory(walking(100, 50.0), H36M)
    save_kinematics(whole, tmp_path / "walk.bvh")
    errors = joint_errors_m(whole, tmp_path / "walk.bvh")
    # The walker's hips turn against its trunk, so the height of the shoulders above them differs by some millimetres.
    assert max(each.max() for each in errors.values()) < 0.005


def test_forward_kinematics_of_bvh_return_to_motion_capture_within_its_bone_lengths(tmp_path: Path) -> None:
    positions_m, fps = embedded_motion("cmu_02_05")
    whole = trajectory(positions_m[:150], H36M, fps=fps)
    save_kinematics(whole, tmp_path / "boxing.bvh")
    errors = joint_errors_m(whole, tmp_path / "boxing.bvh")
    trunk_m = positions_m[:150, [H36M.index("left_shoulder"), H36M.index("right_shoulder")]].mean(axis=1)
    hips_m = positions_m[:150, [H36M.index("left_hip"), H36M.index("right_hip")]].mean(axis=1)
    chain_m = np.linalg.norm(trunk_m - hips_m, axis=1)
    slack_m = np.abs(chain_m - np.median(chain_m))
    bones_m = H36M.bone_lengths(positions_m[:150])
    slack_m = slack_m + np.abs(bones_m - np.median(bones_m, axis=0)).sum(axis=1)
    # Shoulders move against the trunk: they are at the ends of no bone of the file but of their median place in it.
    for joint, error_m in errors.items():
        is_leg = joint.endswith(("hip", "knee", "ankle"))
        assert (error_m < slack_m + 1e-4).all() if is_leg else np.median(error_m) < 0.03, joint


def test_gaps_are_held_in_bvh(walk: Trajectory, tmp_path: Path) -> None:
    save_kinematics(walk, tmp_path / "walk.bvh")
    nodes, _, values = read_bvh(tmp_path / "walk.bvh")
    assert np.isfinite(values).all()
    leg = [nodes["LeftUpLeg"].channels[f"{axis}rotation"] for axis in "ZXY"]
    assert len(leg) == 3
    np.testing.assert_array_equal(values[0], values[1])  # nobody in the first frame


def test_bvh_has_the_rate_of_the_whole_recording(walk: Trajectory, tmp_path: Path) -> None:
    """Its gaps are not in it, and what the file cannot hold is said."""
    rounded = replace(walk, time_s=np.round(np.arange(walk.n_frames) / 60, 3))
    save_kinematics(rounded, tmp_path / "walk.bvh")
    _, frame_time_s, _ = read_bvh(tmp_path / "walk.bvh")
    assert frame_time_s == pytest.approx(1 / 60, abs=1e-3 / (walk.n_frames - 1))  # both ends are rounded to 1 ms
    missing = replace(walk, time_s=np.arange(walk.n_frames) / 60 + (np.arange(walk.n_frames) > 10) * 0.505)
    with pytest.warns(UserWarning, match=r"walk\.bvh: BVH holds a constant frame rate, 60 Hz .* 5 ms later than"):
        save_kinematics(missing, tmp_path / "walk.bvh")


def test_frames_that_are_missing_hold_the_pose_in_bvh(walk: Trajectory, tmp_path: Path) -> None:
    """Ten frames of 50 Hz, in which he goes on to where he is next."""
    whole = replace(walk, time_s=np.arange(walk.n_frames) / 50 + (np.arange(walk.n_frames) > 30) * 0.2)
    save_kinematics(whole, tmp_path / "walk.bvh")
    nodes, frame_time_s, values = read_bvh(tmp_path / "walk.bvh")
    assert (len(values), frame_time_s) == (walk.n_frames + 10, pytest.approx(0.02))
    np.testing.assert_array_equal(values[31:41, 3:], np.broadcast_to(values[30, 3:], (10, values.shape[1] - 3)))
    found_m = places(nodes, values)["Hips"]
    hips_m = walk[["left_hip", "right_hip"]].mean(axis=1)[:, [1, 2, 0]]  # y up
    np.testing.assert_allclose(found_m[41:], hips_m[31:], atol=1e-6)
    np.testing.assert_allclose(
        np.diff(found_m[30:42], axis=0), np.broadcast_to((hips_m[31] - hips_m[30]) / 11, (11, 3)), atol=2e-6
    )


def test_nobody_is_no_bvh(walk: Trajectory, tmp_path: Path) -> None:
    nobody = replace(walk, positions_m=np.full_like(walk.positions_m, np.nan))
    with pytest.raises(ValueError, match=r"nobody\.bvh: hips and shoulders are known in no frame"):
        save_kinematics(nobody, tmp_path / "nobody.bvh")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("world_up", ["z", pytest.param("y", marks=pytest.mark.slow)])
def test_rotations_stand_beside_the_points_in_c3d(world_up, tmp_path: Path) -> None:
    ezc3d = pytest.importorskip("ezc3d")
    rng = np.random.default_rng(3)
    positions_m = np.stack([built(random_angles(rng) | {"left_knee_flexion": 60.0 * (i > 0)}) for i in range(7)])
    positions_m = positions_m if world_up == "z" else positions_m[..., [1, 2, 0]]
    body = trajectory(positions_m)
    path = tmp_path / "body.c3d"
    save_kinematics(body, path, world_up)
    file = ezc3d.c3d(str(path))
    labels = file["parameters"]["ROTATION"]["LABELS"]["value"]
    poses = segment_poses(body, world_up)
    assert labels == [f"{segment.name}_4X4" for segment in poses.segments]
    assert file["parameters"]["ROTATION"]["RATE"]["value"] == 50.0
    matrices = file["data"]["rotations"].transpose(3, 2, 0, 1)
    assert matrices.shape == (7, len(labels), 4, 4)
    # 32-bit numbers of up to 2000 mm.
    for segment in ("right_shank", "left_forearm", "thorax"):
        index = labels.index(f"{segment}_4X4")
        own, end_m = (
            poses.segments[index],
            {"right_shank": "right_ankle", "left_forearm": "left_wrist", "thorax": "neck"},
        )
        ends_mm = matrices[:, index, :3, 3] + matrices[:, index, :3, :3] @ np.array(own.axis) * 1000 * np.linalg.norm(
            poses.end_m[:, index] - poses.origin_m[:, index], axis=1, keepdims=True
        )
        np.testing.assert_allclose(ends_mm, 1000 * body[end_m[segment]], atol=2e-3)
    assert np.isnan(matrices[0, labels.index("left_thigh_4X4")]).all()  # a straight knee
    assert np.isfinite(matrices[1:, labels.index("left_thigh_4X4")]).all()
    # The points are those of a file without rotations.
    write_c3d(body, tmp_path / "points.c3d", world_up)
    (with_rotations, up), (alone, _) = read_c3d(path), read_c3d(tmp_path / "points.c3d")
    assert up == f"+{world_up}"
    np.testing.assert_array_equal(with_rotations.positions_m, alone.positions_m)
    np.testing.assert_array_equal(with_rotations.time_s, alone.time_s)


def test_people_have_files_of_their_own(walk: Trajectory, tmp_path: Path) -> None:
    written = save_kinematics({1: walk, 4: walk}, tmp_path / "two.mot")
    assert [path.name for path in written] == ["two_person1.mot", "two_person4.mot"]
    assert save_kinematics({3: walk}, tmp_path / "one.mot") == (tmp_path / "one.mot",)
    with pytest.raises(ValueError, match=r"nobody\.mot: there is nobody"):
        save_kinematics({}, tmp_path / "nobody.mot")


def test_who_has_no_body_is_left_out_beside_others(walk: Trajectory, tmp_path: Path) -> None:
    nobody = replace(walk, positions_m=np.full_like(walk.positions_m, np.nan))
    with pytest.warns(UserWarning, match=r"two_person4.bvh: hips and shoulders are known in no frame.*; left out"):
        written = save_kinematics({1: walk, 4: nobody}, tmp_path / "two.bvh", "z")
    assert [path.name for path in written] == ["two_person1.bvh"]


def test_an_extension_is_refused_before_any_work(walk: Trajectory, tmp_path: Path) -> None:
    with pytest.raises(
        ValueError, match=r"walk\.xlsx: kinematics are written as \.parquet, \.csv, \.mot, \.bvh, \.c3d"
    ):
        save_kinematics(walk, tmp_path / "walk.xlsx")


def test_the_command_prints_ranges_and_writes(
    walk: Trajectory, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = tmp_path / "walk.parquet"
    save_trajectory(walk, source)
    outputs = [tmp_path / "out" / name for name in ("angles.mot", "angles.bvh", "angles.parquet")]
    assert main(["angles", str(source), *(word for path in outputs for word in ("-o", str(path)))]) == 0
    out = capsys.readouterr().out
    assert "40 frames, skeleton h36m_17" in out
    angles = joint_angles(load_trajectory(source))
    (line,) = [line for line in out.splitlines() if "right knee flexion" in line]
    number, found = angles.names.index("right_knee_flexion"), angles.ranges((0.0, 0.5, 1.0))
    noise_deg = found.noise_deg[2, number] - found.noise_deg[0, number]
    each = np.stack([found.quantiles_deg[:, number], found.sigma_deg[:, number]], axis=1).ravel()
    numbers = [float(word.rstrip("%")) for word in line.split()[3:] if word != "±"]
    expected = [*each, noise_deg, 98]
    assert numbers == pytest.approx(expected, abs=0.51)  # whole degrees
    assert all(path.is_file() for path in outputs)


def test_the_command_takes_several_people(walk: Trajectory, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save_people({0: walk, 7: walk}, tmp_path / "two.parquet")
    assert main(["angles", str(tmp_path / "two.parquet"), "-o", str(tmp_path / "angles.bvh")]) == 0
    out = capsys.readouterr().out
    assert "person 0, 40 frames" in out
    assert "person 7, 40 frames" in out
    assert (tmp_path / "angles_person7.bvh").is_file()


def test_the_command_names_what_is_wrong(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["angles", str(tmp_path / "missing.parquet")]) == 2
    assert "missing.parquet" in capsys.readouterr().err
    body = trajectory(np.nan_to_num(built({}))[None])
    save_trajectory(body, tmp_path / "body.parquet")
    assert main(["angles", str(tmp_path / "body.parquet"), "-o", str(tmp_path / "a.txt")]) == 2
    assert "a.txt: kinematics are written as" in capsys.readouterr().err
