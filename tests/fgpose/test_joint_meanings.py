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
from fgpose.io.skeletons import builtin_skeletons, load_skeleton
from fgpose.io.trajectories import load_trajectory, save_trajectory
from fgpose.kinematics.angles import joint_angles
from fgpose.shown.joint_meanings import found_among, marker_names, marker_of_joint, meanings
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
    assert marker_names(("RHip", "left_knee", "pelvis", "head")) == ("RHip", "LKnee", "Hip", "Head")
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


# Names in Markers_*.xml of OpenSim_Setup, Pose2Sim 0.10.49.
_BODY = {"Nose", *(f"{side}{part}" for side in "LR" for part in ("Shoulder", "Elbow", "Wrist", "Hip", "Knee", "Ankle"))}
_FEET = {f"{side}{part}" for side in "LR" for part in ("BigToe", "SmallToe", "Heel")}
_HANDS = {f"{side}{part}" for side in "LR" for part in ("Thumb", "Index", "Pinky")}
_EYES = {"LEye", "REye"}
MODELS = {
    "Body25": _BODY | _FEET | {"Neck", "CHip"},
    "Body25b": _BODY | _FEET | {"Neck", "Head"},
    "Coco17": _BODY | {"Neck"},
    "Halpe26": _BODY | _FEET | {"Neck", "Head", "Hip"},
    "Halpe68_136": _BODY | _FEET | _HANDS | {"Neck", "Head", "Hip"},
    "Coco133": _BODY | _FEET | _HANDS | _EYES,
    "BlazePose": _BODY | (_FEET - {"LSmallToe", "RSmallToe"}) | _HANDS | _EYES,
}


@pytest.mark.parametrize(
    ("name", "model", "lacks"),
    [
        *((name, "Body25", set()) for name in ("body_25", "openpose_67", "openpose_137")),
        ("body_25b", "Body25b", set()),
        ("coco_17", "Coco17", {"Neck"}),
        ("halpe_26", "Halpe26", set()),
        ("halpe_136", "Halpe68_136", set()),
        *((name, "Coco133", set()) for name in ("coco_wholebody_133", "mhr_70")),
        *((name, "BlazePose", set()) for name in ("blazepose_33", "holistic_75")),
    ],
)
def test_markers_are_those_of_the_models_of_pose2sim(name: str, model: str, lacks: set[str]) -> None:
    assert MODELS[model] - set(marker_names(load_skeleton(name).joints)) == lacks


def test_a_finger_of_the_models_is_the_joint_beside_the_palm() -> None:
    """Ids in skeletons.py of Pose2Sim: COCO_133 and HALPE_136."""
    for name, ids in {
        "coco_wholebody_133": {"LThumb": 93, "LIndex": 96, "LPinky": 108, "RThumb": 114, "RIndex": 117, "RPinky": 129},
        "halpe_136": {"LThumb": 96, "LIndex": 99, "LPinky": 111, "RThumb": 117, "RIndex": 120, "RPinky": 132},
    }.items():
        markers = marker_names(load_skeleton(name).joints)
        assert {marker: markers.index(marker) for marker in ids} == ids


@pytest.mark.parametrize("name", builtin_skeletons())
@pytest.mark.parametrize("is_old", [False, True])
def test_files_of_all_skeletons_come_back(name: str, tmp_path: Path, *, is_old: bool) -> None:
    """Also those of versions that named each marker after its joint alone."""
    skeleton = load_skeleton(name)
    markers = tuple(map(marker_of_joint, skeleton.joints)) if is_old else marker_names(skeleton.joints)
    assert len(set(markers)) == skeleton.n_joints
    np.testing.assert_array_equal(found_among(skeleton.joints, markers), np.arange(skeleton.n_joints))
    positions_m = np.random.default_rng(1).normal(size=(1, skeleton.n_joints, 3))
    shown = Trajectory(skeleton, np.zeros(1), positions_m, np.full((1, skeleton.n_joints), Status.OBSERVED))
    save_trajectory(shown, tmp_path / "walk.trc", "z")
    text = (tmp_path / "walk.trc").read_text()
    written = marker_names(skeleton.joints)
    (tmp_path / "walk.trc").write_text(text.replace("\t\t\t".join(written), "\t\t\t".join(markers)))
    np.testing.assert_array_equal(load_trajectory(tmp_path / "walk.trc", skeleton).positions_m, positions_m)
