"""Worlds whose up is not z, in files: nobody lies in a file for other programs without its being said."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fgpose.cli.app import main
from fgpose.geometry.up_axis import y_up, z_up_R_world
from fgpose.io.origin import Origin
from fgpose.io.skeletons import load_skeleton
from fgpose.io.trajectories import load_trajectory, load_upright, save_people, save_trajectory
from fgpose.io.trajectories.kinematics import load_angles, save_kinematics
from fgpose.kinematics.angles import joint_angles
from fgpose.report.results import load_finished
from fgpose.trajectory import Status, Trajectory
from fgpose_benchmarks.synthetic import ring_rig, walking

FPS = 50.0


@pytest.fixture(scope="module")
def walk() -> Trajectory:
    positions_m = walking(60, FPS)
    status = np.full(positions_m.shape[:2], Status.OBSERVED)
    covariance_m2 = np.broadcast_to(np.diag([1e-4, 4e-4, 9e-4]), (*positions_m.shape, 3)).copy()
    return Trajectory(load_skeleton("h36m_17"), np.arange(60) / FPS, positions_m, status, covariance_m2)


def turned(walk: Trajectory, axis: Any) -> Trajectory:
    return walk.turned(z_up_R_world(axis).T)


@pytest.mark.parametrize(
    ("extension", "axis"),
    # C3D files are read by another process, which has to begin.
    [
        *((".trc", axis) for axis in ("+x", "-y", "-z")),
        (".c3d", "-y"),
        *(pytest.param(".c3d", axis, marks=pytest.mark.slow) for axis in ("+x", "-z")),
    ],
)
def test_files_for_other_programs_stand_upright_whatever_axis_is_up(
    walk: Trajectory, tmp_path: Path, axis: Any, extension: str
) -> None:
    if extension == ".c3d":
        pytest.importorskip("ezc3d")
    path = tmp_path / f"walk{extension}"
    with pytest.warns(UserWarning, match=re.escape(f"{path}: the body stands along {axis} of the world, not along +z")):
        save_trajectory(turned(walk, axis), path)
    # 1e-6 m: C3D has 32 bit.
    np.testing.assert_allclose(load_trajectory(path).positions_m, walk.positions_m, atol=1e-6)
    back = load_trajectory(path, world_up=axis)
    np.testing.assert_allclose(back.positions_m, turned(walk, axis).positions_m, atol=1e-6)


def test_people_of_one_recording_are_turned_alike(walk: Trajectory, tmp_path: Path) -> None:
    """One of three lies; alone he would be taken to stand."""
    lying = turned(walk, "+x")
    people = {0: turned(walk, "-y"), 1: turned(walk, "-y"), 2: lying}
    with pytest.warns(UserWarning, match="along -y"):
        save_people(people, tmp_path / "all.trc")
    written = load_trajectory(tmp_path / "all_person2.trc", file_up="y").positions_m
    np.testing.assert_allclose(written, lying.turned(z_up_R_world("-y")).positions_m, atol=1e-12)


def test_angles_do_not_depend_on_the_axis_that_is_up(walk: Trajectory, tmp_path: Path) -> None:
    """Values and standard deviations; heights too."""
    save_kinematics(walk, tmp_path / "z.parquet")
    with pytest.warns(UserWarning, match="along -y"):
        save_kinematics(turned(walk, "-y"), tmp_path / "down.parquet")
    expected, found = (load_angles(tmp_path / name)[0] for name in ("z.parquet", "down.parquet"))
    np.testing.assert_allclose(found.angle_deg, expected.angle_deg, atol=1e-9)
    np.testing.assert_allclose(found.sigma_deg, expected.sigma_deg, atol=1e-6)
    # A camera's world that looks down by 20 degrees, as a direction.
    tilt = np.deg2rad(20.0)
    up = (0.0, -float(np.cos(tilt)), float(np.sin(tilt)))
    tilted = joint_angles(walk.turned(z_up_R_world(up).T), up)
    np.testing.assert_allclose(tilted.angle_deg, expected.angle_deg, atol=1e-9)


def trc(path: Path, positions_m: np.ndarray, unit: str = "mm", separator: str = "\t", comma: bool = False) -> Path:
    """A TRC file as other programs write it; of no unit, millimetres."""
    scale = {"m": 1, "cm": 100, "mm": 1000, "": 1000}[unit]
    skeleton = load_skeleton("h36m_17")
    n_frames, n_joints = positions_m.shape[:2]
    names = [cell for joint in skeleton.joints for cell in (joint, "", "")]
    keys = ["DataRate", "CameraRate", "NumFrames", "NumMarkers", "Units", "OrigDataRate", "OrigDataStartFrame"]
    lines = [["PathFileType", "4", "(X/Y/Z)", path.name], [*keys, "OrigNumFrames"]]
    lines += [["50", "50", str(n_frames), str(n_joints), unit, "50", "1", str(n_frames)], ["Frame#", "Time", *names]]
    lines += [["", "", *(f"{axis}{n + 1}" for n in range(n_joints) for axis in "XYZ")], []]
    for frame, row in enumerate(scale * positions_m.reshape(n_frames, -1)):
        cells = [f"{frame / FPS:.6f}", *(f"{value:.6f}" for value in row)]
        lines.append([str(frame + 1), *(cell.replace(".", ",") if comma else cell for cell in cells)])
    path.write_text("\n".join(separator.join(line) for line in lines) + "\n")
    return path


@pytest.mark.parametrize(
    ("unit", "separator", "comma"),
    [("mm", "\t", False), ("cm", "\t", False), ("m", ",", False), ("mm", ";", True), ("mm", "\t", True)],
)
def test_trc_as_table_programs_leave_it(
    walk: Trajectory, tmp_path: Path, unit: str, separator: str, comma: bool
) -> None:
    path = trc(tmp_path / "walk.trc", y_up(walk.positions_m, "z"), unit, separator, comma)
    loaded = load_trajectory(path, walk.skeleton)
    np.testing.assert_allclose(loaded.positions_m, walk.positions_m, atol=1e-6)  # six decimals
    np.testing.assert_allclose(loaded.time_s, walk.time_s, atol=1e-6)


def test_trc_without_a_unit_is_told_by_the_legs(walk: Trajectory, tmp_path: Path) -> None:
    path = trc(tmp_path / "walk.trc", y_up(walk.positions_m, "z"), "")
    with pytest.warns(UserWarning, match=r"walk\.trc: line 3 names no unit: lengths are taken to be mm, which fits"):
        loaded = load_trajectory(path, walk.skeleton)
    np.testing.assert_allclose(loaded.positions_m, walk.positions_m, atol=1e-6)
    path.write_text(path.read_text().replace("left_knee", "LKNE").replace("right_knee", "RKNE"))
    with pytest.raises(ValueError, match="Units is missing, and no legs of a person tell it"):
        load_trajectory(path)


def test_a_trc_of_a_giant_has_another_unit(walk: Trajectory, tmp_path: Path) -> None:
    path = trc(tmp_path / "walk.trc", y_up(walk.positions_m, "z"), "m")
    path.write_text(path.read_text().replace("\tm\t", "\tcm\t"))
    with pytest.warns(UserWarning, match=r"line 3 says cm, in which legs are 0\.\d+ long: lengths are taken to be m"):
        loaded = load_trajectory(path, walk.skeleton)
    np.testing.assert_allclose(loaded.positions_m, walk.positions_m, atol=1e-6)


def test_a_trc_with_z_up_is_read_upright_and_said(walk: Trajectory, tmp_path: Path) -> None:
    path = trc(tmp_path / "zup.trc", walk.positions_m)
    with pytest.warns(UserWarning, match=r"zup\.trc: the body stands along \+z of the world, not along \+y.*=\+y"):
        loaded = load_trajectory(path, walk.skeleton)
    np.testing.assert_allclose(loaded.positions_m, walk.positions_m, atol=1e-6)
    as_said = load_trajectory(path, walk.skeleton, file_up="y").positions_m
    np.testing.assert_allclose(as_said, walk.turned(z_up_R_world("y")).positions_m, atol=1e-6)


@pytest.mark.filterwarnings("always::UserWarning")
def test_angles_and_evaluate_of_a_trc_with_z_up(
    walk: Trajectory, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_trajectory(walk, tmp_path / "walk.parquet")
    standing, lying = (
        trc(tmp_path / "yup.trc", y_up(walk.positions_m, "z")),
        trc(tmp_path / "zup.trc", walk.positions_m),
    )
    tables = []
    for path in (standing, lying):
        assert main(["angles", str(path)]) == 0
        printed = capsys.readouterr()
        tables.append(printed.out.splitlines()[1:])
        assert ("zup.trc: the body stands along +z" in printed.err) == (path == lying)
        assert main(["evaluate", str(tmp_path / "walk.parquet"), str(path)]) == 0
        printed = capsys.readouterr()
        assert re.search(r"MPJPE, absolute \[mm\] +0\.0\b", printed.out)
    assert tables[0] == tables[1]
    assert main(["angles", str(lying), "--world-up", "z"]) == 0
    printed = capsys.readouterr()
    assert (printed.out.splitlines()[1:], printed.err) == (tables[0], "")
    assert main(["angles", str(lying), "--world-up", "-y"]) == 0
    printed = capsys.readouterr()
    assert printed.out.splitlines()[1:] != tables[0]
    said = (
        "--world-up -y was given, but the body stands along +z of the world, not along -y. Give --world-up +z, or auto"
    )
    assert said in printed.err
    assert main(["evaluate", str(standing), str(lying), "--reference-up", "-y"]) == 0
    assert said.replace("--world-up", "--reference-up") in capsys.readouterr().err


def test_a_given_axis_of_a_result_is_questioned_as_its_estimate_was(walk: Trajectory, tmp_path: Path) -> None:
    path, origin = tmp_path / "walk.parquet", Origin((), ring_rig(), fps=FPS, fgpose="1")
    save_trajectory(walk, path, origin=origin)
    with pytest.warns(UserWarning, match=r"walk\.parquet: --world-up x was given, but the body stands along \+z"):
        load_upright(path, "x")
    load_upright(path, "z")  # warnings are errors
    # Who lies before level cameras does, whatever is given.
    save_trajectory(turned(walk, "+x"), path, origin=origin)
    load_upright(path, "z")


def test_a_report_of_a_world_with_y_down_is_turned_with_its_cameras(walk: Trajectory, tmp_path: Path) -> None:
    world_R_up = z_up_R_world("-y").T
    rig = ring_rig()
    save_trajectory(
        turned(walk, "-y"), tmp_path / "walk.parquet", origin=Origin((), rig.turned(world_R_up), fps=FPS, fgpose="1")
    )
    with pytest.warns(UserWarning, match="along -y of the world"):
        recording = load_finished(tmp_path / "walk.parquet")
    assert recording.rig is not None
    np.testing.assert_allclose(recording.main.positions_m, walk.positions_m, atol=1e-12)
    for camera, true in zip(recording.rig.cameras, rig.cameras, strict=True):
        np.testing.assert_allclose(camera.world_T_camera, true.world_T_camera, atol=1e-12)
    assert "stands along -y" in recording.made_from["Axes"]
    assert "turned by the rotation (0 0 1, -1 0 0, 0 -1 0)" in recording.made_from["Axes"]
    save_trajectory(walk, tmp_path / "upright.parquet", origin=Origin((), rig, fps=FPS, fgpose="1"))
    assert "Axes" not in load_finished(tmp_path / "upright.parquet").made_from


def test_a_result_is_turned_level_by_the_cameras_it_was_made_with(walk: Trajectory, tmp_path: Path) -> None:
    """Somebody who lies before level cameras stays lying: the file knows the cameras."""
    lying = turned(walk, "+x")
    save_trajectory(lying, tmp_path / "lies.parquet", origin=Origin((), ring_rig(), fps=FPS, fgpose="1"))
    with pytest.warns(UserWarning, match=r"lies\.parquet: the body lies or stands on its head"):
        people, rotation = load_upright(tmp_path / "lies.parquet")
    np.testing.assert_array_equal(people[0].positions_m, lying.positions_m)
    np.testing.assert_array_equal(rotation, np.eye(3))
