"""Names of cameras and of frames, as files have them."""

from __future__ import annotations

from pathlib import Path

import pytest

from fgpose.io.names import camera_name, frame_numbers, match_cameras, recording_name, seen_cameras


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["frame000012_cam01", "frame000013_cam01"], [12, 13]),
        (["cam01_000012_halpe26", "cam01_000013_halpe26"], [12, 13]),
        (["cam01_000012-1", "cam01_000013-1"], [12, 13]),
        (["000012_1679059200123", "000013_1679059200156"], [12, 13]),
        (["cam01_12"], [12]),
        (["frame12_cam01"], [12]),
        (["take2_0001", "take2_0002", "take3_0001"], [1, 2, 1]),
        (["cam01.0036", "0037"], [36, 37]),
        (["x", "x1"], [None, 1]),
    ],
)
def test_the_number_of_the_frame_is_the_one_that_counts(names: list[str], expected: list[int | None]):
    assert list(frame_numbers(names, "cam01").values()) == expected


def test_a_camera_called_by_a_number_is_no_frame():
    assert frame_numbers(["1", "2", "3"], "1") == {"1": 1, "2": 2, "3": 3}


@pytest.mark.parametrize(
    ("file", "name"),
    [
        ("cam01_json", "cam01"),
        ("results_cam01", "cam01"),
        ("AlphaPose_cam01", "cam01"),
        ("cam01DLC_resnet50_walkNov25shuffle1_100000_filtered", "cam01"),
        ("cam01", "cam01"),
        ("results", "results"),
    ],
)
def test_names_of_cameras_are_without_what_detectors_add(file: str, name: str):
    assert camera_name(file) == name


def test_words_that_all_share_do_not_count():
    found, rig = ("S01_walk_cam1_v2", "S01_walk_cam2_v2"), ("cam_01", "cam_02")
    assert match_cameras(found, rig) == {"cam_01": found[0], "cam_02": found[1]}
    assert seen_cameras(found[::-1], rig) == rig


def test_videos_of_qualisys_end_with_the_serial_number():
    found, rig = ("Walk1_Miqus_1_21299", "Walk1_Miqus_2_21300"), ("21299", "21300")
    assert match_cameras(found, rig) == dict(zip(rig, found, strict=True))
    with pytest.raises(ValueError, match="no camera in common"):
        match_cameras(found, ("21299", "21301"))


def test_cameras_that_are_counted_otherwise_are_never_taken_for_their_neighbours():
    found, calibrated = ("cam1_json", "cam2_json", "cam3_json", "cam4_json"), ("cam_0", "cam_1", "cam_2", "cam_3")
    with pytest.raises(ValueError, match="one seems to count from 1, the other from 0") as error:
        match_cameras(found, calibrated)
    message = str(error.value)
    assert "cam1_json is cam_0, cam2_json is cam_1, cam3_json is cam_2, cam4_json is cam_3" in message
    assert "--cameras" not in message
    # One camera more: which of the two it is cannot be known.
    with pytest.raises(ValueError, match="If cam1_json is cam_0, and so on, rename the folders or files; otherwise"):
        match_cameras(found, (*calibrated, "cam_4"))


def test_cameras_of_both_sides_alone_are_not_advised_away():
    with pytest.raises(ValueError, match="Is one of them the other") as error:
        match_cameras(("cam1", "cam2", "left"), ("cam1", "cam2", "right"))
    assert "--cameras" not in str(error.value)


def test_a_folder_has_no_extension(tmp_path: Path) -> None:
    folder, file = tmp_path / "walk_1.0_x", tmp_path / "walk_2.0_x.npz"
    folder.mkdir()
    file.touch()
    (tmp_path / "link").symlink_to(folder)
    assert recording_name(folder) == recording_name(tmp_path / "link") == "walk_1.0_x"
    assert recording_name(file) == "walk_2.0_x"
