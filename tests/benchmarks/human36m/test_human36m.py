"""Human3.6M from the labels of Learnable Triangulation."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fgpose.io.skeletons import load_skeleton
from fgpose_benchmarks.human36m.labels import image_path, in_skeleton_order, load_label_rigs, load_labels
from tests.benchmarks.human36m.human36m_files import h36m_rig, labels, motion_of_32, sequence, truth_of

RIGS = {"S1": h36m_rig(1.0), "S9": h36m_rig(), "S11": h36m_rig(0.3)}
ACTIONS = {
    ("S1", "Eating-1"): np.arange(0, 20, 5),
    ("S9", "Greeting-2"): np.arange(0, 50, 5),
    ("S11", "Eating-1"): np.arange(0, 15, 5),
    ("S9", "Eating-1"): np.arange(0, 35, 5),
}


def saved(folder: Path, content: dict) -> Path:
    path = folder / "human36m-multiview-labels-GTbboxes.npy"
    np.save(path, np.array(content, dtype=object), allow_pickle=True)
    return path


def test_the_test_subjects_come_sequence_by_sequence(tmp_path: Path):
    sequences = load_labels(saved(tmp_path, labels(ACTIONS, RIGS)))
    assert [each.key for each in sequences] == [("S9", "Eating-1"), ("S9", "Greeting-2"), ("S11", "Eating-1")]
    for each in sequences:
        frames = ACTIONS[each.key]
        np.testing.assert_array_equal(each.frames, frames)
        # single precision of millimetres
        np.testing.assert_allclose(each.truth_m, truth_of(motion_of_32(len(frames))), atol=1e-6)


def test_the_cameras_see_the_truth_where_they_did(tmp_path: Path):
    for each in load_labels(saved(tmp_path, labels(ACTIONS, RIGS))):
        assert [camera.size_px for camera in each.rig.cameras] == [
            (1000, height) for height in (1002, 1000, 1000, 1002)
        ]
        true_px = RIGS[each.subject].project(each.truth_m)
        # single precision of rotations and focal lengths, at 1145 px
        np.testing.assert_allclose(each.rig.project(each.truth_m), true_px, atol=2e-3)
        for camera, original in zip(each.rig.cameras, RIGS[each.subject].cameras, strict=True):
            np.testing.assert_allclose(camera.distortion, original.distortion, rtol=1e-6)


def test_joints_are_mapped_by_name():
    names = load_skeleton("h36m_17_lt").joints
    places = {"right_ankle": 0, "pelvis": 6, "thorax": 8, "head": 9, "right_wrist": 10, "left_wrist": 15}
    positions = np.arange(17.0)[None, :, None].repeat(3, axis=2)
    ordered = in_skeleton_order(positions, names)
    for name, place in {**places, "neck_base": 16}.items():
        assert ordered[0, load_skeleton("h36m_17").index(name), 0] == place
    with pytest.raises(ValueError, match="joint pelvis is missing"):
        in_skeleton_order(positions[:, :16], [name for name in names if name != "pelvis"])


def test_boxes_are_turned_round_and_missing_views_are_nan(tmp_path: Path):
    content = labels({("S9", "Eating-1"): np.arange(4)}, {"S9": h36m_rig()}, missing_view=(2, 1))
    (each,) = load_labels(saved(tmp_path, content), ["S9"])
    # top 200, left 300, bottom 800, right 900
    np.testing.assert_array_equal(each.boxes_px[0, 0], [300, 200, 600, 600])
    assert np.isnan(each.boxes_px[2, 1]).all()
    assert each.has_view.sum() == 15
    assert np.isnan(each.joint_boxes_px()[2, 1]).all()


def test_the_box_of_the_joints_holds_them_all_and_little_more():
    each = sequence("S9", "Eating-1", np.arange(6))
    boxes_px = each.joint_boxes_px()
    for c, camera in enumerate(each.rig.cameras):
        points_px = camera.distort(camera.project(each.truth_m))
        low_px, high_px = boxes_px[:, c, :2], boxes_px[:, c, :2] + boxes_px[:, c, 2:]
        assert (points_px.min(axis=1) > low_px).all()
        assert (points_px.max(axis=1) < high_px).all()
        # a margin of 3 % of the height on either side
        height_px = np.ptp(points_px[..., 1], axis=1)
        np.testing.assert_allclose(boxes_px[:, c, 3], 1.06 * height_px, rtol=1e-9)


def test_the_first_image_is_number_one():
    each = sequence("S9", "Eating-1", np.arange(2))
    path = image_path(Path("processed"), each, "54138969", 64)
    assert path == Path("processed/S9/Eating-1/imageSequence/54138969/img_000065.jpg")


def test_the_rigs_of_all_subjects_can_be_had(tmp_path: Path):
    rigs = load_label_rigs(saved(tmp_path, labels(ACTIONS, RIGS)))
    assert list(rigs) == ["S1", "S9", "S11"]
    np.testing.assert_allclose(rigs["S1"].cameras[2].position_m, RIGS["S1"].cameras[2].position_m, atol=1e-5)


def test_what_is_wrong_is_said(tmp_path: Path):
    content = labels(ACTIONS, RIGS)
    with pytest.raises(ValueError, match="there is no subject S8; there is S1, S9, S11"):
        load_labels(saved(tmp_path, content), ["S8"])
    with pytest.raises(ValueError, match="cameras, table is missing"):
        load_labels(
            saved(tmp_path, {name: content[name] for name in ("subject_names", "camera_names", "action_names")})
        )
    # labels of before 2019 have 16 joints
    table = content["table"]
    kept = [name for name in table.dtype.names if name != "keypoints"]
    with pytest.raises(ValueError, match=r"GTbboxes\.npy.*table has no field keypoints of shape \(17, 3\)"):
        load_labels(saved(tmp_path, content | {"table": table[kept]}))
    doubled = np.concatenate([table, table[-1:]])
    with pytest.raises(ValueError, match="S9/Eating-1: frame numbers must increase"):
        load_labels(saved(tmp_path, content | {"table": doubled}))
    with pytest.raises(FileNotFoundError):
        load_labels(tmp_path / "nowhere.npy")
