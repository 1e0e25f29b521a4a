"""Joints that are called as in Pose2Sim and OpenPose (RHip) are those of fgpose (right_hip), wherever they meet."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import fgpose
from fgpose.assessment.evaluation import evaluate
from fgpose.assessment.people import evaluate_people
from fgpose.cli import main
from fgpose.io.skeletons import load_skeleton
from fgpose.io.trajectories import load_trajectory, save_trajectory
from fgpose.kinematics.angles import joint_angles
from fgpose.shown.joint_meanings import found_among, marker_names, meanings
from fgpose.trajectory import Status, Trajectory
from fgpose_benchmarks.synthetic import walking

H36M = load_skeleton("h36m_17")


@pytest.fixture
def walk() -> Trajectory:
    positions_m = walking(12, 50.0)
    status = np.full(positions_m.shape[:2], Status.OBSERVED)
    return Trajectory(H36M, np.arange(12) / 50, positions_m, status)


@pytest.fixture
def camel(walk: Trajectory) -> Trajectory:
    """The same with joints called RHip, LKnee."""
    return replace(walk, skeleton=replace_names(walk.skeleton, marker_names(H36M.joints)))


def replace_names(skeleton: fgpose.Skeleton, joints: tuple[str, ...]) -> fgpose.Skeleton:
    return fgpose.Skeleton(
        "own", joints, skeleton.bones, skeleton.root, skeleton.left_right, skeleton.limbs, skeleton.lines
    )


def test_names_that_mean_the_same_stay_different() -> None:
    assert meanings(("RHip", "LKnee", "Hip", "C7")) == ("right_hip", "left_knee", "pelvis", "C7")
    assert meanings(("right_hip", "RHip", "LKnee")) == ("right_hip", "RHip", "left_knee")
    assert meanings(("RightHip", "RHip")) == ("RightHip", "RHip")
    assert marker_names(("right_hip", "RHip", "left_knee")) == ("right_hip", "RHip", "LKnee")
    assert marker_names(("RHip", "left_knee", "pelvis")) == ("RHip", "LKnee", "Hip")
    np.testing.assert_array_equal(found_among(("RHip", "left_knee", "tail"), ("LKnee", "right_hip")), [1, 0, -1])
    np.testing.assert_array_equal(found_among(("right_hip", "RHip"), ("RHip",)), [-1, 0])


@pytest.mark.parametrize("extension", [".trc", ".c3d", ".parquet"])
def test_a_result_comes_back_in_its_own_skeleton(camel: Trajectory, tmp_path: Path, extension: str) -> None:
    if extension == ".c3d":
        pytest.importorskip("ezc3d")
    path = tmp_path / f"camel{extension}"
    save_trajectory(camel, path, "z")
    for skeleton in (camel.skeleton, H36M):
        read = load_trajectory(path, skeleton, file_up="z" if extension == ".c3d" else "auto")
        assert read.skeleton == skeleton
        np.testing.assert_allclose(read.positions_m, camel.positions_m, rtol=2**-23)  # C3D has 32 bits


@pytest.mark.parametrize("extension", [".trc", ".c3d"])
def test_names_that_mean_the_same_are_written_and_read(walk: Trajectory, tmp_path: Path, extension: str) -> None:
    if extension == ".c3d":
        pytest.importorskip("ezc3d")
    path, names = tmp_path / f"twice{extension}", list(H36M.joints)
    names[H36M.index("head")] = "RHip"
    twice = replace(walk, skeleton=replace_names(H36M, tuple(names)))
    save_trajectory(twice, path, "z")
    read = load_trajectory(path, twice.skeleton, file_up="z" if extension == ".c3d" else "auto")
    np.testing.assert_allclose(read.positions_m, twice.positions_m, rtol=2**-23)
    assert load_trajectory(path).skeleton.joints == tuple(names)


def test_they_are_compared(walk: Trajectory, camel: Trajectory) -> None:
    moved = replace(camel, positions_m=camel.positions_m + np.array([0.0, 0.0, 0.01]))
    found = evaluate(moved, walk)
    assert found.n_joints == H36M.n_joints
    assert found.mpjpe_absolute_mm == pytest.approx(10.0)
    assert found.mpjpe_relative_mm == pytest.approx(0.0, abs=1e-9)  # the hips of both are the root
    assert [score.joint for score in found.joints] == list(camel.skeleton.joints)
    people = evaluate_people({0: moved}, {0: walk})
    assert (people.mpjpe_mm, people.pcp) == (pytest.approx(10.0), 1.0)


def test_they_have_the_same_angles(
    walk: Trajectory, camel: Trajectory, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ours, theirs = joint_angles(walk), joint_angles(camel)
    assert theirs.names == ours.names
    np.testing.assert_array_equal(theirs.angle_deg, ours.angle_deg)
    save_trajectory(camel, tmp_path / "camel.parquet", "z")
    assert main(["angles", str(tmp_path / "camel.parquet")]) == 0
    assert "left knee flexion" in capsys.readouterr().out
