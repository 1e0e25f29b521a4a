"""Skeletons: the built-in ones keep the published joint orders, a user's own is checked."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fgpose.io.skeletons import builtin_skeletons, load_skeleton
from fgpose.skeleton import LIMBS, Skeleton

# Facts of each format's own documentation; enough to notice a shifted or swapped order.
PUBLISHED = {
    "blazepose_33": {0: "nose", 11: "left_shoulder", 16: "right_wrist", 23: "left_hip", 28: "right_ankle"},
    "body_25": {
        0: "nose",
        1: "neck",
        4: "right_wrist",
        7: "left_wrist",
        8: "pelvis",
        14: "left_ankle",
        22: "right_big_toe",
    },
    "body_25b": {0: "nose", 5: "left_shoulder", 12: "right_hip", 16: "right_ankle", 17: "neck", 24: "right_heel"},
    "coco_17": {
        0: "nose",
        5: "left_shoulder",
        6: "right_shoulder",
        9: "left_wrist",
        12: "right_hip",
        16: "right_ankle",
    },
    "openpose_67": {0: "nose", 24: "right_heel", 25: "left_hand_root", 29: "left_thumb_tip", 46: "right_hand_root"},
    "openpose_137": {45: "left_pinky_tip", 67: "right_jaw_1", 75: "chin", 97: "nose_tip", 135: "right_pupil"},
    "coco_wholebody_133": {
        9: "left_wrist",
        17: "left_big_toe",
        20: "right_big_toe",
        23: "right_jaw_1",
        31: "chin",
        53: "nose_tip",
        59: "right_eye_outer",
        68: "left_eye_outer",
        71: "right_mouth_corner",
        91: "left_hand_root",
        99: "left_index_tip",
        112: "right_hand_root",
        132: "right_pinky_tip",
    },
    "halpe_136": {17: "head", 25: "right_heel", 26: "right_jaw_1", 94: "left_hand_root", 135: "right_pinky_tip"},
    "holistic_75": {32: "right_foot_index", 33: "left_hand_root", 54: "right_hand_root", 74: "right_pinky_tip"},
    "h36m_17": {
        0: "pelvis",
        1: "right_hip",
        6: "left_ankle",
        7: "spine",
        10: "head",
        13: "left_wrist",
        16: "right_wrist",
    },
    "h36m_17_lt": {0: "right_ankle", 3: "left_hip", 6: "pelvis", 9: "head_top", 10: "right_wrist", 16: "nose"},
    "halpe_26": {
        0: "nose",
        16: "right_ankle",
        17: "head",
        18: "neck",
        19: "pelvis",
        20: "left_big_toe",
        25: "right_heel",
    },
    "mhr_70": {
        0: "nose",
        9: "left_hip",
        14: "right_ankle",
        20: "right_heel",
        21: "right_thumb_tip",
        40: "right_pinky_mcp",
        41: "right_wrist",
        45: "left_thumb_cmc",
        62: "left_wrist",
        69: "neck",
    },
    "smpl_24": {
        0: "pelvis",
        1: "left_hip",
        8: "right_ankle",
        12: "neck",
        15: "head",
        20: "left_wrist",
        23: "right_hand",
    },
}

OWN = """
name = "arm"
joints = ["chest", "left_shoulder", "left_elbow", "right_shoulder", "right_elbow"]
root = ["chest"]
bones = [["chest", "left_shoulder"], ["chest", "right_shoulder"], ["left_shoulder", "left_elbow"],
         ["right_shoulder", "right_elbow"]]
left_right = [["left_shoulder", "right_shoulder"], ["left_elbow", "right_elbow"]]

[limbs]
upper_arm = ["left_shoulder", "left_elbow"]
"""


@pytest.fixture(params=builtin_skeletons())
def builtin(request: pytest.FixtureRequest) -> Skeleton:
    return load_skeleton(request.param)


def test_every_published_order_is_built_in() -> None:
    assert set(builtin_skeletons()) == set(PUBLISHED)


def test_joint_order_is_the_published_one(builtin: Skeleton) -> None:
    assert {index: builtin.joints[index] for index in PUBLISHED[builtin.name]} == PUBLISHED[builtin.name]
    assert builtin.n_joints == int(re.findall("_([0-9]+)", builtin.name)[0])


def test_limb_pairs_are_the_four_of_the_paper(builtin: Skeleton) -> None:
    ends = (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"))
    names = [(builtin.bone_name(left), builtin.bone_name(right)) for left, right in builtin.limb_pairs]
    assert names == [(f"left_{a}-left_{b}", f"right_{a}-right_{b}") for a, b in ends]
    assert len(LIMBS) == 4


def test_mirrored_bones_share_a_length_and_others_do_not(builtin: Skeleton) -> None:
    number = dict(zip((frozenset(bone) for bone in builtin.bones), builtin.length_of_bone, strict=True))
    for bone in builtin.bones:
        same = {b for b, length in number.items() if length == number[frozenset(bone)]}
        assert same <= {frozenset(bone), frozenset(builtin.mirrored(bone))}
        assert number[frozenset(builtin.mirrored(bone))] == number[frozenset(bone)]
    assert len(builtin.length_names) == builtin.n_lengths == max(builtin.length_of_bone) + 1


def test_every_side_joint_has_its_mirror_image(builtin: Skeleton) -> None:
    sides = {(builtin.joints[left], builtin.joints[right]) for left, right in builtin.left_right}
    assert sides == {(joint, joint.replace("left", "right")) for joint in builtin.joints if joint.startswith("left")}


def test_neighbours_are_the_ends_of_the_bones(builtin: Skeleton) -> None:
    edges = {(a, b) for a, around in enumerate(builtin.neighbours) for b in around}
    assert edges == {*builtin.bones, *((b, a) for a, b in builtin.bones)}


def test_arms_and_legs_are_bones_from_the_root_outwards(builtin: Skeleton) -> None:
    for a, b in (("left_shoulder", "left_elbow"), ("right_knee", "right_ankle")):
        assert (builtin.index(a), builtin.index(b)) in builtin.bones


def test_bone_lengths_of_known_positions(skeleton: Skeleton) -> None:
    positions_m = np.zeros((2, 17, 3))
    positions_m[:, skeleton.index("left_knee")] = (0, 3, 4)
    positions_m[1, 0] = np.nan
    lengths_m = skeleton.bone_lengths(positions_m)
    assert lengths_m[0, skeleton.bones.index((4, 5))] == 5.0
    assert np.isnan(lengths_m[1, skeleton.bones.index((0, 4))])


def test_the_root_of_a_skeleton_without_pelvis_is_both_hips() -> None:
    coco = load_skeleton("coco_17")
    assert {coco.joints[joint] for joint in coco.root} == {"left_hip", "right_hip"}


def test_a_users_own_skeleton(tmp_path: Path) -> None:
    path = tmp_path / "arm.toml"
    path.write_text(OWN)
    arm = load_skeleton(path)
    assert (arm.name, arm.n_joints, arm.n_lengths, arm.length_of_bone) == ("arm", 5, 2, (0, 0, 1, 1))
    assert arm.limb_pairs == (((1, 2), (3, 4)),)
    path.write_text(OWN.replace('"arm"', '"other"'))
    assert load_skeleton(path).name == "other", "a changed file is read again"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('root = ["chest"]', "", "root is missing"),
        ('root = ["chest"]', 'root = ["hip"]', "'hip' is not one of the joints"),
        ('root = ["chest"]', "root = []", "a root are needed"),
        ('root = ["chest"]', 'root = ["chest"]\ncolour = "red"', "unknown key colour"),
        ('"chest", "left_shoulder", ', '"chest", "chest", "left_shoulder", ', "repeated: chest"),
        ('[["chest", "left_shoulder"], ', '[["chest"], ', "a pair of joints is needed"),
        ('[["chest", "left_shoulder"], ', '[["chest", "chest"], ', "bones joins chest to itself"),
        ('[["chest", "left_shoulder"], ', '[["right_shoulder", "chest"], ', "bones names one pair twice"),
        ('["left_elbow", "right_elbow"]]', '["left_elbow", "right_shoulder"]]', "names right_shoulder twice"),
        ("upper_arm", "tail", "limbs are upper_arm, lower_arm, upper_leg, lower_leg, got tail"),
        ('upper_arm = ["left_shoulder"', 'upper_arm = ["chest"', "limb chest-left_elbow or its mirror image is not"),
        (', ["left_elbow", "right_elbow"]]', "]", "left_shoulder-left_elbow or its mirror image is not a bone"),
        ("root = [", "root = ", "not a skeleton"),
    ],
)  # fmt: skip
def test_a_bad_skeleton_file_is_one_clear_error(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = tmp_path / "arm.toml"
    assert old in OWN
    path.write_text(OWN.replace(old, new, 1))
    with pytest.raises(ValueError, match=message) as error:
        load_skeleton(path)
    assert str(error.value).startswith(f"{path}: not a skeleton: ")


@pytest.mark.parametrize(
    ("given", "name"),
    [
        ("BODY_25", "body_25"),
        ("BODY_25B", "body_25b"),
        ("halpe26", "halpe_26"),
        ("COCO", "coco_17"),
        ("smpl", "smpl_24"),
    ],
)
def test_names_are_found_as_other_programs_write_them(given: str, name: str) -> None:
    assert load_skeleton(given).name == name


def test_a_name_that_may_mean_two_is_refused() -> None:
    with pytest.raises(ValueError, match=r"no skeleton 'h36m': did you mean h36m_17 or h36m_17_lt\?"):
        load_skeleton("h36m")
    with pytest.raises(ValueError, match=r"no skeleton 'cocco_17': did you mean coco_17\?"):
        load_skeleton("cocco_17")


def test_an_unknown_name_lists_the_built_in_skeletons() -> None:
    with pytest.raises(ValueError, match=r"no skeleton 'coco_18'.*coco_17, coco_wholebody_133, h36m_17"):
        load_skeleton("coco_18")


def test_an_unknown_joint_lists_the_joints(skeleton: Skeleton) -> None:
    with pytest.raises(ValueError, match=r"h36m_17 has no joint 'nose'; it has pelvis, right_hip"):
        skeleton.index("nose")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"joints": ()}, "at least one joint"),
        ({"root": (7,)}, "root uses joint 7, there are 3"),
        ({"bones": ((0, -1),)}, "bones uses joint -1"),
        ({"left_right": (), "limbs": ((0, 1),)}, "limb a-b is its own mirror image"),
    ],
)
def test_bad_indices_are_one_clear_error(change: dict[str, Any], message: str) -> None:
    good: dict[str, Any] = {"name": "s", "joints": ("a", "b", "c"), "bones": ((0, 1), (0, 2)), "root": (0,)}
    with pytest.raises(ValueError, match=f"skeleton s: .*{message}"):
        Skeleton(**(good | change))


def test_the_mirror_is_its_own_inverse(builtin: Skeleton) -> None:
    np.testing.assert_array_equal(builtin.mirror[builtin.mirror], np.arange(builtin.n_joints))
    for joint, other in enumerate(builtin.mirror.tolist()):
        assert builtin.mirrored((joint, other)) == (other, joint)
        side = builtin.joints[joint]
        swapped = side.replace("left", "L").replace("right", "left").replace("L", "right")
        assert builtin.joints[other] == swapped


def test_without_sides_every_joint_is_its_own_mirror_image() -> None:
    np.testing.assert_array_equal(Skeleton("points", ("a", "b", "c"), (), (0,)).mirror, [0, 1, 2])


def test_joints_may_be_given_by_name() -> None:
    joints, sides = ("hip", "left_knee", "right_knee"), [("left_knee", "right_knee")]
    named = Skeleton("legs", joints, [("hip", "left_knee"), ("hip", 2)], root="hip", left_right=sides)
    assert named == Skeleton("legs", joints, ((0, 1), (0, 2)), (0,), ((1, 2),))
    assert Skeleton("legs", joints, (), ["left_knee", "right_knee"]).root == (1, 2)
    assert Skeleton("legs", joints, (), 1).root == (1,)
    assert hash(named) == hash(Skeleton("legs", joints, named.bones, 0, named.left_right))
    with pytest.raises(ValueError, match=r"skeleton legs has no joint 'hpi' \(did you mean hip\?\)"):
        Skeleton("legs", joints, (), root="hpi")
    with pytest.raises(ValueError, match="skeleton legs has no joint 'knee'"):
        Skeleton("legs", joints, [("hip", "knee")], root="hip")


def test_a_name_is_taken_where_a_skeleton_is() -> None:
    """In a process of its own, whose types are not checked: what is held is a Skeleton, and so say the types."""
    program = """
import numpy as np
import fgpose
from fgpose.people import PeopleObservations
coco, time_s, points_px = fgpose.load_skeleton("coco_17"), np.arange(3) / 50, np.full((3, 2, 17, 2), 100.0)
assert fgpose.Observations("COCO", time_s, points_px).skeleton == coco
everybody = PeopleObservations.of_frames("coco_17", ("a", "b"), time_s, points_px[:, :, None], np.ones((3, 2, 1, 17)))
assert everybody.skeleton == PeopleObservations("coco17", ("a", "b"), everybody.images).skeleton == coco
status = np.full((3, 17), fgpose.Status.OBSERVED)
assert fgpose.Trajectory("coco_17", time_s, np.zeros((3, 17, 3)), status).skeleton == coco
assert fgpose.kinematics.angle_names("coco_17") == fgpose.kinematics.angle_names(coco) != ()
fgpose.Observations("coko_17", time_s, points_px)
"""
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert run.stderr.splitlines()[-1].startswith("ValueError: no skeleton 'coko_17': did you mean coco_17? There are")


def test_no_bone_leads_out_of_a_linkage(builtin: Skeleton) -> None:
    number = {joint: at for at, joints in enumerate(builtin.linkages) for joint in joints}
    assert sorted(joint for joints in builtin.linkages for joint in joints) == list(range(builtin.n_joints))
    assert all(number[a] == number[b] for a, b in builtin.bones)
    assert all(list(joints) == sorted(joints) for joints in builtin.linkages)


def test_linkages_of_blazepose_are_arms_face_and_legs() -> None:
    skeleton = load_skeleton("blazepose_33")
    arms, face, legs = ({skeleton.joints[joint] for joint in joints} for joints in skeleton.linkages)
    assert {"left_wrist", "right_thumb"} < arms
    assert {"nose", "left_ear", "right_mouth"} < face
    assert {"left_hip", "right_foot_index"} < legs


def test_small_linkages_are_put_together() -> None:
    """Joints without bones would otherwise each be a set, and each set costs calls."""
    loose = Skeleton("loose", [f"joint_{number}" for number in range(20)], [], 0)
    assert [len(joints) for joints in loose.linkages] == [8, 8, 4]
    chain = Skeleton("chain", loose.joints, [(number, number + 1) for number in range(11)], 0)
    assert [len(joints) for joints in chain.linkages] == [12, 8]


def test_a_limb_pair_is_in_one_linkage() -> None:
    """Symmetry of each frame joins arms that no bone joins."""
    names = [f"{side}_{joint}" for side in ("left", "right") for joint in ("shoulder", "elbow", "wrist", "hand", "tip")]
    bones = [(first + number, first + number + 1) for first in (0, 5) for number in range(4)]
    mirrored = [(joint, joint + 5) for joint in range(5)]
    assert len(Skeleton("arms", names, bones, 0, mirrored).linkages) == 2
    assert len(Skeleton("arms", names, bones, 0, mirrored, limbs=[(0, 1)]).linkages) == 1
