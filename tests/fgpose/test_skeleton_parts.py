"""Hands and faces of skeletons: what belongs to them, and what is refused."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fgpose.io.skeletons import load_skeleton
from fgpose.io.skeletons.tables import skeleton_of, skeleton_table
from fgpose.io.trajectories import load_trajectory, save_trajectory
from fgpose.skeleton import BodyPart, Skeleton
from fgpose.trajectory import Trajectory

WITH_PARTS = ("openpose_67", "openpose_137", "coco_wholebody_133", "halpe_136", "holistic_75", "mhr_70")
NAMES = ("pelvis", "left_wrist", "left_hand_root", "left_thumb_tip", "left_pinky_tip")
BONES = [(0, 1), (2, 3), (2, 4)]
HAND = BodyPart("left_hand", (2, 3, 4), (1, 2), relative_sigma=0.33)


def with_part(**changes: Any) -> Skeleton:
    return Skeleton("one_hand", NAMES, BONES, 0, parts=[dataclasses.replace(HAND, **changes)])


@pytest.mark.parametrize("name", WITH_PARTS)
def test_every_joint_is_of_the_body_or_of_one_part(name: str):
    skeleton = load_skeleton(name)
    joints = [*skeleton.body, *(joint for part in skeleton.parts for joint in part.joints)]
    assert sorted(joints) == list(range(skeleton.n_joints))
    body = skeleton.of_joints(skeleton.body)
    assert len(body.limbs) == 4
    assert body.parts == ()
    for part in skeleton.parts:
        own = skeleton.of_joints(part.estimated if part.is_joined else part.joints, part.name, part.hangs_on[1])
        side = part.name.partition("_")[0]
        if part.name == "face":
            assert {skeleton.joints[skeleton.mirror[joint]] for joint in part.joints} == set(own.joints)
            assert len(part.carried_by) == 8
        else:
            assert all(joint.startswith(f"{side}_") for joint in own.joints)
            assert own.root == (0,)
            assert len(skeleton.of_joints(part.estimated).bones) == 20
            assert skeleton.joints[part.hangs_on[0]] == f"{side}_wrist"
            mirrored = {skeleton.joints[skeleton.mirror[joint]] for joint in part.joints}
            assert all(joint.startswith("right_" if side == "left" else "left_") for joint in mirrored)


def test_both_hands_have_the_same_lengths():
    skeleton = load_skeleton("coco_wholebody_133")
    hands = [bone for bone in skeleton.bones if "hand_root" in skeleton.bone_name(bone)]
    assert len(hands) == 10
    assert len({skeleton.length_of_bone[skeleton.bones.index(bone)] for bone in hands}) == 5


def test_some_joints_keep_what_is_between_them():
    skeleton = load_skeleton("coco_wholebody_133")
    arm = skeleton.of_joints([skeleton.index(each) for each in ("left_wrist", "left_elbow", "right_elbow")], "arm", 7)
    assert arm == Skeleton("arm", ["left_wrist", "left_elbow", "right_elbow"], [(1, 0)], [1], [(1, 2)])
    with pytest.raises(ValueError, match="nose is not among the joints of arm"):
        skeleton.of_joints([7, 9], "arm", 0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"joints": (2, 9)}, "part left_hand uses joint 9"),
        ({"hangs_on": (1, 0)}, "hangs on or is carried by a joint that is not in it"),
        ({"carried_by": (2, 3)}, "is carried by at least three joints"),
        ({"relative_sigma": 0.0}, r"relative_sigma of part left_hand must be in \(0, 1\]"),
        ({"joints": (0, 2, 3, 4)}, "pelvis is in left_hand, not of the body"),
        ({"joints": (2, 3)}, "bone left_hand_root-left_pinky_tip joins a part to something else"),
    ],
)
def test_a_wrong_part_is_named(changes: dict[str, object], message: str):
    with pytest.raises(ValueError, match=message):
        with_part(**changes)


def test_no_joint_is_in_two_parts():
    with pytest.raises(ValueError, match="left_hand_root is in two parts"):
        Skeleton("twice", NAMES, BONES, 0, parts=[HAND, dataclasses.replace(HAND, name="again")])


def test_a_file_of_ones_own(tmp_path: Path):
    path = tmp_path / "one_hand.toml"
    text = (
        f'name = "one_hand"\njoints = {list(NAMES)}\nroot = ["pelvis"]\n'
        'bones = [["pelvis", "left_wrist"], ["left_hand_root", "left_thumb_tip"], '
        '["left_hand_root", "left_pinky_tip"]]\n'
        '[parts.left_hand]\nhangs_on = ["left_wrist", "left_hand_root"]\nrelative_sigma = 0.33\n'
        'joints = ["left_hand_root", "left_thumb_tip", "left_pinky_tip"]\n'
    )
    path.write_text(text)
    assert load_skeleton(path) == with_part()
    for wrong, message in (
        (text.replace("hangs_on", "hung_on"), "parts.left_hand needs joints and hangs_on"),
        (text.replace("0.33", '"small"'), "relative_sigma must be a number"),
        (
            text.replace('joints = ["left_hand_root", ', 'joints = ["left_foot", '),
            "'left_foot' is not one of the joints",
        ),
    ):
        path.write_text(wrong)
        with pytest.raises(ValueError, match=message):
            load_skeleton(path)


def test_parts_are_kept_in_files(tmp_path: Path):
    skeleton = load_skeleton("coco_wholebody_133")
    positions_m = np.random.default_rng(0).normal(size=(3, 133, 3))
    status = np.full((3, 133), 2, dtype=np.int8)
    trajectory = Trajectory(skeleton, np.arange(3) / 30, positions_m, status)
    for name in ("pose.npz", "pose.parquet"):
        save_trajectory(trajectory, tmp_path / name)
        assert load_trajectory(tmp_path / name).skeleton == skeleton


def test_skeletons_of_older_files_have_no_parts():
    table = skeleton_table(load_skeleton("coco_17"))
    assert "parts" not in table
    table = json.loads(json.dumps(table))
    assert skeleton_of(table) == load_skeleton("coco_17")
    with pytest.raises(ValueError, match="its parts are damaged"):
        skeleton_of({**table, "parts": [{"name": "left_hand"}]})
