"""Keypoint files as detectors and people leave them: each is read right, or refused with the way out."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fgpose.geometry.camera import CameraRig
from fgpose.io.keypoints import keypoint_cameras, load_observations, load_people
from fgpose.io.skeletons import load_skeleton
from fgpose.observations import Observations
from fgpose.skeleton import Skeleton
from fgpose_benchmarks.synthetic import ring_rig

COCO = load_skeleton("coco_17")
N_FRAMES = 3
CAMERAS = ("cam01", "cam02")


@pytest.fixture(scope="module")
def rig() -> CameraRig:
    return CameraRig(
        tuple(replace(camera, name=name) for camera, name in zip(ring_rig().cameras[:2], CAMERAS, strict=True))
    )


def points_px(n_joints: int = 17) -> np.ndarray:
    """(frame, camera, joint, 2)."""
    return np.random.default_rng(0).uniform(100, 900, (N_FRAMES, 2, n_joints, 2)).round(2)


def scores(n_joints: int = 17) -> np.ndarray:
    """(frame, camera, joint), up to 0.9."""
    return np.random.default_rng(1).uniform(0.3, 0.9, (N_FRAMES, 2, n_joints)).round(3)


def write(path: Path, document: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(document if isinstance(document, str) else json.dumps(document))


def flat(frame: int, camera: int, scale: float = 1.0, n_joints: int = 17) -> list[float]:
    points, confidence = points_px(n_joints)[frame, camera], scale * scores(n_joints)[frame, camera]
    return np.concatenate([points, confidence[:, None]], axis=1).ravel().tolist()


def openpose(
    folder: Path, name: str = "{camera}_{frame:012d}_keypoints", scale: float = 1.0, n_joints: int = 17
) -> None:
    for c, camera in enumerate(CAMERAS):
        for frame in range(N_FRAMES):
            people = [{"pose_keypoints_2d": flat(frame, c, scale, n_joints)}]
            write(folder / f"{camera}_json" / f"{name.format(camera=camera, frame=frame)}.json", {"people": people})


def instances(frame: int, camera: int, n_joints: int = 17) -> list[dict[str, Any]]:
    points, confidence = points_px(n_joints)[frame, camera], scores(n_joints)[frame, camera]
    return [{"keypoints": points.tolist(), "keypoint_scores": confidence.tolist(), "bbox": [[0, 0, 1, 1]]}]


def mmpose_frames(camera: int, n_joints: int = 17) -> list[dict[str, Any]]:
    return [{"frame_id": frame, "instances": instances(frame, camera, n_joints)} for frame in range(N_FRAMES)]


def alphapose(camera: int, image: str = "{}.jpg") -> list[dict[str, Any]]:
    return [
        {
            "image_id": image.format(frame),
            "category_id": 1,
            "keypoints": flat(frame, camera),
            "score": 2.9,
            "idx": [0.0],
        }
        for frame in range(N_FRAMES)
    ]


def load(path: Path, rig: CameraRig, skeleton: Any = COCO, **options: Any) -> Observations:
    return load_observations(path, rig, skeleton, fps=10.0, **options)


def assert_read(observations: Observations) -> None:
    np.testing.assert_allclose(observations.time_s, np.arange(N_FRAMES) / 10)
    np.testing.assert_allclose(observations.points2d_px, points_px())
    np.testing.assert_allclose(observations.confidence, scores())


def error_of(path: Path, rig: CameraRig, skeleton: Any = COCO, **options: Any) -> str:
    with pytest.raises(ValueError, match=re.escape(path.name)) as error:
        load(path, rig, skeleton, **options)
    return str(error.value)


# Frames


def test_a_camera_that_is_counted_from_1_is_said(tmp_path: Path, rig: CameraRig):
    openpose(tmp_path)
    second = tmp_path / "cam02_json"
    for frame in reversed(range(N_FRAMES)):
        image = second / f"cam02_{frame:012d}_keypoints.json"
        image.rename(second / f"cam02_{frame + 1:012d}_keypoints.json")
    with pytest.warns(UserWarning, match=r"the images of cam02_json are counted from 1, as many of the others from 0"):
        observations = load(tmp_path, rig)
    assert observations.n_frames == N_FRAMES + 1
    (second / f"cam02_{N_FRAMES:012d}_keypoints.json").unlink()
    assert not load(tmp_path, rig).remarks


# Scores


def test_scores_about_one_are_clipped_and_it_is_said(tmp_path: Path, rig: CameraRig):
    openpose(tmp_path, scale=1.2)
    with pytest.warns(UserWarning, match=r"up to 1\.07, as RTMPose's do; \d+ % were above 1 and count as 1"):
        observations = load(tmp_path, rig)
    np.testing.assert_allclose(observations.confidence, np.minimum(1.2 * scores(), 1.0))
    (remark,) = observations.frames(slice(0, 1)).subset(["cam02"]).remarks
    assert str(tmp_path) in remark


@pytest.mark.parametrize("scale", [10.0, 100.0])
def test_scores_of_another_scale_are_divided_and_it_is_said(tmp_path: Path, rig: CameraRig, scale: float):
    openpose(tmp_path, scale=scale)
    with pytest.warns(UserWarning, match=rf"they were divided by {scale:g} to be confidences"):
        observations = load(tmp_path, rig)
    assert_read(observations)
    assert observations.remarks


def test_joints_at_zero_are_missing_and_it_is_said(tmp_path: Path, rig: CameraRig):
    """In the file of one camera: (0, 0), with the usual confidence."""
    openpose(tmp_path)
    keypoints = np.reshape(flat(1, 0), (-1, 3))
    keypoints[[3, 5], :2] = 0.0
    path = tmp_path / "cam01_json" / "cam01_000000000001_keypoints.json"
    write(path, {"people": [{"pose_keypoints_2d": keypoints.ravel().tolist()}]})
    with pytest.warns(UserWarning, match=r"2 of 102 keypoints stand at exactly \(0, 0\), with a confidence above 0"):
        observations = load(tmp_path, rig)
    missing = np.zeros((N_FRAMES, 2, 17), dtype=bool)
    missing[1, 0, [3, 5]] = True
    np.testing.assert_array_equal(~observations.seen, missing)
    np.testing.assert_array_equal(observations.confidence == 0, missing)
    assert "taken for missing" in observations.remarks[0]


def test_a_camera_that_sees_little_does_not_change_the_scale(tmp_path: Path, rig: CameraRig):
    """RTMW, whose scores go up to 10: in one view of three all are low."""
    three = CameraRig((*rig.cameras, replace(ring_rig().cameras[2], name="cam03")))
    openpose(tmp_path, scale=10.0)
    for frame in range(N_FRAMES):
        name = f"cam03_{frame:012d}_keypoints.json"
        write(tmp_path / "cam03_json" / name, {"people": [{"pose_keypoints_2d": flat(frame, 0)}]})
    with pytest.warns(UserWarning, match="divided by 10"):
        observations = load(tmp_path, three)
    np.testing.assert_allclose(observations.confidence[:, 2], scores()[:, 0] / 10)


def test_a_single_large_score_is_refused(tmp_path: Path, rig: CameraRig):
    openpose(tmp_path)
    wrong = [*flat(1, 1)[:-1], 80.0]
    write(tmp_path / "cam02_json" / "cam02_000000000001_keypoints.json", {"people": [{"pose_keypoints_2d": wrong}]})
    message = error_of(tmp_path, rig)
    assert "camera cam02_json, frame 1, joint right_ankle: person 0 has a confidence outside [0, 1]: 80" in message


def test_visibilities_of_annotations_are_no_confidences(tmp_path: Path, rig: CameraRig):
    for c, camera in enumerate(CAMERAS):
        points = points_px()[:, c]
        seen = np.tile([2.0, 1.0, 0.0, 2.0, 2.0], 4)[:17]
        rows = [np.concatenate([each, seen[:, None]], axis=1).ravel().tolist() for each in points]
        write(tmp_path / f"{camera}.json", [{"image_id": i, "keypoints": row} for i, row in enumerate(rows)])
    assert "as the visibility in annotations of COCO, which is no confidence" in error_of(tmp_path, rig)
    write(tmp_path / "cam01.json", {"images": [], "annotations": [], "categories": []})
    assert "annotations of COCO, not what a detector found; give results" in error_of(tmp_path, rig)


# Who is there


def test_an_empty_person_is_nobody(tmp_path: Path, rig: CameraRig):
    """Pose2Sim keeps the places of people who are not in an image."""
    openpose(tmp_path)
    nobody = tmp_path / "cam01_json" / "cam01_000000000001_keypoints.json"
    write(nobody, {"people": [{}]})
    second = tmp_path / "cam02_json" / "cam02_000000000001_keypoints.json"
    write(second, {"people": [{}, {"pose_keypoints_2d": flat(1, 1)}]})
    people = load_people(tmp_path, rig, COCO, fps=10.0)
    assert [image.n_people for image in people.by_camera["cam01"]] == [1, 0, 1]
    assert not load(tmp_path, rig, person=0).seen[1].any()
    np.testing.assert_allclose(load(tmp_path, rig, person=1).points2d_px[1, 1], points_px()[1, 1])


def test_an_empty_file_among_good_ones_is_named(tmp_path: Path, rig: CameraRig):
    openpose(tmp_path)
    (tmp_path / "cam02_json" / "cam02_000000000001_keypoints.json").write_text("")
    message = error_of(tmp_path, rig)
    assert "cam02_000000000001_keypoints.json, camera cam02_json, frame 1" in message
    assert "the file is empty. Let the detector write it again, or remove it" in message


# Forms of files


def write_mmpose_video(folder: Path) -> None:
    for c, camera in enumerate(CAMERAS):
        write(folder / f"results_{camera}.json", mmpose_frames(c))


def write_mmpose_demo(folder: Path) -> None:
    for c, camera in enumerate(CAMERAS):
        meta = {"dataset_name": "coco", "keypoint_id2name": {str(i): name for i, name in enumerate(COCO.joints)}}
        write(folder / f"results_{camera}.json", {"meta_info": meta, "instance_info": mmpose_frames(c)})


def write_alphapose_files(folder: Path) -> None:
    for c, camera in enumerate(CAMERAS):
        write(folder / f"AlphaPose_{camera}.json", alphapose(c))


def write_alphapose_folders(folder: Path) -> None:
    for c, camera in enumerate(CAMERAS):
        write(folder / camera / "alphapose-results.json", alphapose(c, f"frame{{:06d}}_{camera}.jpg"))
        write(folder / camera / "vis" / "0.json", "no keypoints")


def write_frame_first(folder: Path) -> None:
    openpose(folder, "frame{frame:06d}_{camera}")


def write_words_behind(folder: Path) -> None:
    openpose(folder, "{camera}_{frame:06d}_halpe26")


def write_hidden_beside(folder: Path) -> None:
    openpose(folder)
    for file in [*folder.glob("*/*.json"), *folder.iterdir()]:
        hidden = file.with_name(f"._{file.name}")
        hidden.mkdir() if file.is_dir() else hidden.write_bytes(b"\0\5\x16\7\0\2\0\0Mac OS X        ")
    write(folder / ".cache" / "a.json", "no keypoints")


def dlc_table(camera: int, likelihood: bool = True, joints: tuple[str, ...] = COCO.joints) -> str:
    kinds = ("x", "y", "likelihood")[: 3 if likelihood else 2]
    parts = [joint.replace("_", " ").title() for joint in (*joints[::-1], "hat")]
    rows = [["scorer", *("DLC" for _ in parts for _ in kinds)]]
    rows += [["bodyparts", *(part for part in parts for _ in kinds)], ["coords", *(kinds * len(parts))]]
    for frame in range(N_FRAMES):
        values = np.concatenate([points_px()[frame, camera], scores()[frame, camera][:, None]], axis=1)[::-1]
        cells = [f"{value}" for value in np.vstack([values, [0.0, 0.0, 0.0]])[:, : len(kinds)].ravel()]
        rows.append([str(frame), *cells[: len(parts) * len(kinds)]])
    return "\n".join(map(",".join, rows)) + "\n"


@pytest.mark.parametrize(
    "make",
    [
        write_mmpose_video,
        write_mmpose_demo,
        write_alphapose_files,
        write_alphapose_folders,
        write_frame_first,
        write_words_behind,
        write_hidden_beside,
    ],
)
def test_it_is_read_right(tmp_path: Path, rig: CameraRig, make: Callable[[Path], None]):
    make(tmp_path)
    assert_read(load(tmp_path, rig))


def test_tables_of_deeplabcut(tmp_path: Path, rig: CameraRig):
    """In another order, with other names of joints, and with a part that is no joint."""
    for c, camera in enumerate(CAMERAS):
        write(tmp_path / f"{camera}DLC_resnet50_walkNov25shuffle1_100000.csv", dlc_table(c))
    write(tmp_path / "timestamps.csv", "time,frame\n0,0\n")
    with pytest.warns(UserWarning, match="of the 18 joints in the files only those of skeleton coco_17 are used"):
        assert_read(load(tmp_path, rig))
    stick = Skeleton("stick", ("nose", "tail"), bones=((0, 1),), root=(0,))
    assert "it has no body part tail of skeleton stick, only Right Ankle" in error_of(tmp_path, rig, stick)
    for c, camera in enumerate(CAMERAS):
        file = tmp_path / f"{camera}DLC_resnet50_walkNov25shuffle1_100000.csv"
        write(file, dlc_table(c, likelihood=False))
    with pytest.warns(UserWarning, match="joints"):
        assert (load(tmp_path, rig).confidence == 1).all()
    write(tmp_path / "cam02DLC_resnet50_walkNov25shuffle1_100000.csv", dlc_table(1).replace("coords", "other"))
    assert "not a table of DeepLabCut: it lacks the rows bodyparts and coords" in error_of(tmp_path, rig)


@pytest.mark.parametrize("decimal", [".", ","])
def test_tables_of_deeplabcut_that_excel_has_saved(tmp_path: Path, rig: CameraRig, decimal: str):
    for c, camera in enumerate(CAMERAS):
        table = "\ufeff" + dlc_table(c)
        if c:
            table = table.replace(",", ";").replace(".", decimal)
        (tmp_path / f"{camera}DLC_x.csv").write_text(table, encoding="utf-8", newline="\r\n")
    with pytest.warns(UserWarning, match="joints"):
        assert_read(load(tmp_path, rig))


@pytest.mark.parametrize("stem", ["{camera}DLC_resnet50", "{camera}", "{camera}/{camera}DLC_resnet50"])
@pytest.mark.filterwarnings("ignore:.*of the 18 joints")
def test_the_table_from_which_a_filtered_one_was_made_is_read(tmp_path: Path, rig: CameraRig, stem: str):
    for c, camera in enumerate(CAMERAS):
        path = tmp_path / stem.format(camera=camera)
        write(path.with_name(f"{path.name}.csv"), dlc_table(c))
        write(path.with_name(f"{path.name}_filtered.csv"), dlc_table(1 - c))
    with pytest.warns(
        UserWarning, match=r"of each table and its filtered one the first is read, not cam01\w*_filtered"
    ):
        assert_read(load(tmp_path, rig))


def test_several_individuals_of_deeplabcut(tmp_path: Path, rig: CameraRig):
    for c, camera in enumerate(CAMERAS):
        one = [line.split(",") for line in dlc_table(c).splitlines()]
        two = [
            row + (row[1:] if row[0] in ("scorer", "bodyparts", "coords", "0") else [""] * len(row[1:])) for row in one
        ]
        two.insert(1, ["individuals", *["a"] * len(one[0][1:]), *["b"] * len(one[0][1:])])
        write(tmp_path / f"{camera}DLC_x.csv", "\n".join(map(",".join, two)))
    with pytest.warns(UserWarning, match="joints"):
        people = load_people(tmp_path, rig, COCO, fps=10.0)
    assert [image.n_people for image in people.by_camera["cam01"]] == [2, 1, 1]


def test_the_array_of_freemocap(tmp_path: Path, rig: CameraRig):
    whole = np.random.default_rng(2).uniform(100, 900, (2, N_FRAMES, 553, 3))
    whole[1, 1] = np.nan
    path = tmp_path / "mediapipe2dData_numCams_numFrames_numTrackedPoints_pixelXY.npy"
    np.save(path, whole)
    np.save(tmp_path / "mediapipe3dData_numFrames_numTrackedPoints_spatialXYZ.npy", np.zeros((3, 553, 3)))
    for given in (path, tmp_path):
        with pytest.warns(UserWarning, match="in the order of the calibration"):
            observations = load(given, rig, "blazepose_33")
        np.testing.assert_allclose(observations.points2d_px, whole[:, :, :33, :2].swapaxes(0, 1))
        assert observations.camera_names == CAMERAS
    with pytest.warns(UserWarning, match="in the order of the calibration"):
        with_hands = load(path, rig, "holistic_75").points2d_px.swapaxes(0, 1)
    for part, places in (("left_hand", slice(54, 75)), ("right_hand", slice(33, 54))):
        joints = next(each.joints for each in load_skeleton("holistic_75").parts if each.name == part)
        np.testing.assert_allclose(with_hands[:, :, list(joints)], whole[:, :, places, :2])
    assert keypoint_cameras(path) == ("cam_0", "cam_1")
    assert "553 points in each image" in error_of(path, rig)
    assert "it has 2 cameras without names, the calibration 1" in error_of(path, rig.subset(["cam01"]), "blazepose_33")
    path.write_bytes(path.read_bytes()[:-8])
    assert "a damaged npy" in error_of(path, rig, "blazepose_33")


def test_what_cannot_be_read_is_named_with_the_way(tmp_path: Path, rig: CameraRig):
    for camera in CAMERAS:
        write(tmp_path / f"{camera}DLC_resnet50.h5", "HDF")
    assert "HDF5, as of DeepLabCut or SLEAP: give the table instead (csv" in error_of(tmp_path, rig)


@pytest.mark.parametrize("folder", ["", "{camera}/"])
@pytest.mark.parametrize("rest", ["meta", "full", "assemblies"])
def test_pickles_that_deeplabcut_leaves_are_of_no_network(tmp_path: Path, rig: CameraRig, folder: str, rest: str):
    for camera in CAMERAS:
        stem = f"{folder.format(camera=camera)}{camera}DLC_resnet50"
        write(tmp_path / f"{stem}.h5", "HDF")
        write(tmp_path / f"{stem}_{rest}.pickle", "pickle")
    assert "its .h5 files are HDF5, as of DeepLabCut or SLEAP: give the table instead" in error_of(tmp_path, rig)


# Which joints


@pytest.mark.parametrize(("n_joints", "skeleton"), [(133, "coco_17"), (136, "halpe_26"), (135, "body_25b")])
def test_of_whole_bodies_the_joints_of_the_skeleton_are_read(
    tmp_path: Path, rig: CameraRig, n_joints: int, skeleton: str
):
    openpose(tmp_path, n_joints=n_joints)
    with pytest.warns(UserWarning, match=f"of the {n_joints} joints in the files only those of skeleton {skeleton}"):
        observations = load(tmp_path, rig, skeleton)
    np.testing.assert_allclose(observations.points2d_px, points_px(n_joints)[:, :, : observations.skeleton.n_joints])


def test_whole_bodies_without_some_joints_name_the_skeleton_that_fits(tmp_path: Path, rig: CameraRig):
    openpose(tmp_path, n_joints=133)
    message = error_of(tmp_path, rig, "halpe_26")
    assert "skeleton halpe_26 has 26 joints. The 133 are COCO-WholeBody, without head, neck, pelvis" in message
    assert "use --skeleton coco_17" in message
    openpose(tmp_path, n_joints=26)
    assert "skeleton coco_17 has 17 joints. So many has halpe_26" in error_of(tmp_path, rig)


@pytest.mark.parametrize(
    ("n_joints", "skeleton", "said"),
    [
        (133, "halpe_136", "The 133 are COCO-WholeBody: use --skeleton coco_wholebody_133"),
        (136, "coco_wholebody_133", "The 136 are Halpe with face and hands: use --skeleton halpe_136"),
        (25, "coco_wholebody_133", "So many has body_25 or body_25b"),
    ],
)
def test_a_skeleton_with_hands_names_the_one_that_fits_too(
    tmp_path: Path, rig: CameraRig, n_joints: int, skeleton: str, said: str
):
    openpose(tmp_path, n_joints=n_joints)
    message = error_of(tmp_path, rig, skeleton)
    assert f"pose_keypoints_2d has {3 * n_joints} numbers, skeleton {skeleton} needs" in message
    assert said in message


@pytest.mark.parametrize("names", [True, False])
def test_joints_that_the_file_names_are_compared_with_the_skeleton(tmp_path: Path, rig: CameraRig, names: bool):
    meta: dict[str, Any] = {"dataset_name": "coco"}
    meta |= {"keypoint_id2name": {str(i): name for i, name in enumerate(COCO.joints)}} if names else {}
    for c, camera in enumerate(CAMERAS):
        write(tmp_path / f"{camera}.json", {"meta_info": meta, "instance_info": mmpose_frames(c)})
    message = error_of(tmp_path, rig, "h36m_17")
    for part in (
        "its joints are nose, left_eye",
        "of coco",
        "not those of skeleton h36m_17",
        "give --skeleton coco_17",
    ):
        assert part in message
    # A skeleton of one's own, with other words, cannot be compared.
    words = Skeleton("words", tuple(f"j{i}" for i in range(17)), bones=((0, 1),), root=(0,))
    if names:
        assert load(tmp_path, rig, words).n_frames == N_FRAMES


# Where they are


def test_a_folder_too_high_or_too_low_is_told(tmp_path: Path, rig: CameraRig):
    openpose(tmp_path / "trial" / "pose")
    (tmp_path / "trial" / "videos").mkdir()
    pose = tmp_path / "trial" / "pose"
    assert f"no keypoints, but there are some in {pose}: give that one" in error_of(tmp_path / "trial", rig)
    assert f"there are some in {pose}: give that one" in error_of(tmp_path, rig)
    low = error_of(pose / "cam01_json", rig)
    assert "OpenPose of a single image, where files of a whole camera are expected" in low
    assert f"give the folder above it, {pose}" in low


def test_a_folder_above_files_of_whole_cameras_is_told(tmp_path: Path, rig: CameraRig):
    write_mmpose_video(tmp_path / "pose")
    for c, camera in enumerate(CAMERAS):
        write(tmp_path / "tables" / f"{camera}DLC_resnet50.csv", dlc_table(c))
    assert f"some in {tmp_path / 'pose'}, {tmp_path / 'tables'}: give one of these" in error_of(tmp_path, rig)
