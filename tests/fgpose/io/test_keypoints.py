from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.io.calibration import load_rig
from fgpose.io.keypoints import keypoint_cameras, load_observations, save_observations
from fgpose.io.skeletons import load_skeleton
from fgpose.observations import Observations
from fgpose.skeleton import Skeleton
from fgpose_benchmarks.synthetic import ring_rig

DATA = Path(__file__).parents[2] / "data"
OPENPOSE = DATA / "balance_openpose" / "pose"
STICK = Skeleton("stick", ("hip", "knee", "ankle"), bones=((0, 1), (1, 2)), root=(0,))


@pytest.fixture(scope="module")
def balance_rig() -> CameraRig:
    return load_rig(DATA / "qualisys" / "Calib_qualisys.toml")


@pytest.fixture
def rig() -> CameraRig:
    """Two cameras 4 m from the origin, the second a quarter turn about the vertical from the first."""
    K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    turned = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    return CameraRig(
        tuple(
            Camera.from_world_to_camera(name, (640, 480), K, R, np.array([0, 0, 4.0]))
            for name, R in (("cam_1", np.eye(3)), ("cam_2", turned))
        )
    )


@pytest.fixture
def openpose(tmp_path: Path) -> Path:
    """A copy of the real recording that a test may damage."""
    return Path(shutil.copytree(OPENPOSE, tmp_path / "pose"))


def write_json(path: Path, document: Any) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(document))
    return path


def stick_px(frame: int, camera: int) -> list[list[float]]:
    return [[100.0 + frame, 50.0 + 100 * joint + camera] for joint in range(3)]


def flat(points: list[list[float]], *scores: float) -> list[float]:
    return [value for point, score in zip(points, scores, strict=True) for value in (*point, score)]


def openpose_image(*people: list[float]) -> dict[str, Any]:
    return {"version": 1.3, "people": [{"person_id": [-1], "pose_keypoints_2d": person} for person in people]}


def write_openpose(folder: Path, camera: str, frame: int, *people: list[float]) -> Path:
    return write_json(folder / f"{camera}_json" / f"{camera}_{frame:012d}_keypoints.json", openpose_image(*people))


def error_of(path: Path, rig: CameraRig, skeleton: Any = STICK, **options: Any) -> str:
    with pytest.raises(ValueError, match=re.escape(path.name)) as error:
        load_observations(path, rig, skeleton, **(dict[str, Any](fps=10.0) | options))
    return str(error.value)


# OpenPose


def test_real_openpose(balance_rig: CameraRig):
    observations = load_observations(OPENPOSE, balance_rig, "body_25b", fps=60.0)
    assert observations.points2d_px.shape == (5, 4, 25, 2)
    assert observations.camera_names == ("cam_01", "cam_02", "cam_03", "cam_04")
    np.testing.assert_allclose(observations.time_s, np.arange(36, 41) / 60)
    raw = json.loads((OPENPOSE / "cam03_json" / "cam03.0038.json").read_text())["people"][0]["pose_keypoints_2d"]
    raw = np.reshape(raw, (25, 3))
    missing = raw[:, 2] == 0
    np.testing.assert_array_equal(observations.seen[2, 2], ~missing)
    np.testing.assert_allclose(observations.points2d_px[2, 2][~missing], raw[~missing, :2])
    np.testing.assert_allclose(observations.confidence[2, 2], raw[:, 2])


def test_hands_and_face_of_openpose(tmp_path: Path):
    """In lists of their own, or all in one as Pose2Sim has them; a hand that was not looked for is missing."""
    skeleton, rig = load_skeleton("openpose_137"), ring_rig().subset(["ring_0"])
    values = np.random.default_rng(0).uniform(1, 400, (137, 3))
    values[:, 2] /= 400
    lists = {"pose_keypoints_2d": skeleton.body}
    names = {"left_hand": "hand_left", "right_hand": "hand_right", "face": "face"}
    lists |= {f"{names[part.name]}_keypoints_2d": part.joints for part in skeleton.parts}
    person = {key: values[list(joints)].ravel().tolist() for key, joints in lists.items()}
    of_frames = (person, {**person, "hand_left_keypoints_2d": []}, {"pose_keypoints_2d": values.ravel().tolist()})
    for frame, each in enumerate(of_frames):
        write_json(tmp_path / "ring_0_json" / f"ring_0_{frame:012d}_keypoints.json", {"people": [each]})
    observations = load_observations(tmp_path, rig, skeleton, fps=30.0)
    np.testing.assert_allclose(observations.points2d_px[[0, 2], 0], np.stack(2 * [values[:, :2]]))
    np.testing.assert_allclose(observations.confidence[[0, 2], 0], np.stack(2 * [values[:, 2]]))
    left = list(lists["hand_left_keypoints_2d"])
    assert not observations.seen[1, 0, left].any()
    assert observations.seen[1, 0].sum() == 137 - 21
    person["face_keypoints_2d"] = person["face_keypoints_2d"][:-3]
    write_json(tmp_path / "ring_0_json" / "ring_0_000000000003_keypoints.json", {"people": [person]})
    message = "face_keypoints_2d has 207 numbers, skeleton openpose_137 needs 210"
    with pytest.raises(ValueError, match=rf"ring_0_000000000003_keypoints.json.*frame 3.*{message}"):
        load_observations(tmp_path, rig, skeleton, fps=30.0)


def test_real_openpose_keeps_the_subject_in_whatever_order(openpose: Path, balance_rig: CameraRig):
    in_order = load_observations(openpose, balance_rig, "body_25b", fps=60.0)
    for path in openpose.glob("*/*.json"):
        document = json.loads(path.read_text())
        document["people"].reverse()
        write_json(path, document)
    reversed_order = load_observations(openpose, balance_rig, "body_25b", fps=60.0)
    last = load_observations(openpose, balance_rig, "body_25b", fps=60.0, person=0)
    np.testing.assert_array_equal(reversed_order.points2d_px, in_order.points2d_px)
    assert not np.array_equal(last.seen, in_order.seen)


def test_missing_keypoints_frames_and_people(tmp_path: Path, rig: CameraRig):
    some = flat(stick_px(0, 0), 0.5, 0.6, 0.7)
    write_openpose(tmp_path, "CAM-1", 3, [*some[:3], 0, 0, 0, float("nan"), 5.0, 0.4])
    write_openpose(tmp_path, "CAM-1", 4)
    write_openpose(tmp_path, "CAM-1", 6, some)
    write_openpose(tmp_path, "cam2", 3, some)
    (tmp_path / "cam1_img").mkdir()
    observations = load_observations(tmp_path, rig, STICK, fps=10.0)
    np.testing.assert_allclose(observations.time_s, [0.3, 0.4, 0.5, 0.6])
    assert observations.seen[:, 0].tolist() == [[True, False, False], [False] * 3, [False] * 3, [True] * 3]
    assert observations.seen[:, 1].any(axis=-1).tolist() == [True, False, False, False]


def test_numbers_in_steps_keep_their_step(tmp_path: Path, rig: CameraRig):
    for frame in (10, 15, 25):
        for camera in ("cam1", "cam2"):
            write_openpose(tmp_path, camera, frame, flat(stick_px(0, 0), 1, 1, 1))
    observations = load_observations(tmp_path, rig, STICK, fps=50.0)
    np.testing.assert_allclose(observations.time_s, [0.2, 0.3, 0.4, 0.5])


def test_a_confidence_a_little_above_one_is_one(tmp_path: Path, rig: CameraRig):
    for camera in ("cam1", "cam2"):
        write_openpose(tmp_path, camera, 0, flat(stick_px(0, 0), 1.04, 1, 1))
    with pytest.warns(UserWarning, match=r"up to 1.04, as RTMPose's do; 33 % were above 1 and count as 1"):
        observations = load_observations(tmp_path, rig, STICK, fps=50.0)
    assert observations.confidence.max() == 1


@pytest.mark.parametrize(
    ("damage", "expected"),
    [
        (lambda text: text[:300], ["not JSON, or a truncated file"]),
        (lambda text: "", ["the file is empty", "remove it"]),
        (lambda text: "\x00\x01\x02", ["not JSON"]),
        (lambda text: "[1, 2]", ["something else", "OpenPose"]),
        (lambda text: '{"persons": []}', ["something else", "OpenPose"]),
        (lambda text: '{"people": [{"person_id": 1}]}', ["pose_keypoints_2d"]),
        (lambda text: '{"people": [[]]}', ["not a list of objects"]),
        (lambda text: json.dumps(openpose_image([1.0] * 51)), ["17 keypoints", "body_25b has 25 joints"]),
        (lambda text: json.dumps(openpose_image([1.0] * 72 + [5.0, 6.0, 80.0])), ["joint right_heel", "[0, 1]: 80"]),
        (lambda text: json.dumps(openpose_image([1.0] * 72 + [5.0, 6.0, -0.1])), ["joint right_heel", "[0, 1]: -0.1"]),
        (lambda text: json.dumps(openpose_image([float("inf")] + [1.0] * 74)), ["joint nose", "infinite"]),
        (lambda text: json.dumps(openpose_image([1e200] + [1.0] * 74)), ["joint nose", "infinite"]),
        (lambda text: '{"people": [{"pose_keypoints_2d": ["a"]}]}', ["not numbers"]),
        (lambda text: '[{"keypoints": [[1, 2]], "keypoint_scores": [1]}]', ["this is MMPose, not OpenPose"]),
    ],
)
def test_a_bad_image_file(openpose: Path, balance_rig: CameraRig, damage: Callable[[str], str], expected: list[str]):
    path = openpose / "cam02_json" / "cam02.0038.json"
    path.write_text(damage(path.read_text()))
    message = error_of(openpose, balance_rig, "body_25b")
    for part in ("cam02.0038.json", "camera cam02", "frame 38", *expected):
        assert part in message


@pytest.mark.parametrize("content", [b"", b"no parquet"])
def test_a_parquet_file_without_its_content_is_said_to_be_damaged(tmp_path: Path, rig: CameraRig, content: bytes):
    path = tmp_path / "walk.parquet"
    path.write_bytes(content)
    assert f"{path}: a damaged parquet file" in error_of(path, rig)


def test_an_empty_file_is_not_called_another_format(tmp_path: Path, rig: CameraRig):
    path = tmp_path / "walk.json"
    path.write_bytes(b"")
    assert f"{path}, camera walk: the file is empty" in error_of(path, rig)


def test_a_file_name_without_or_with_a_repeated_number(openpose: Path, balance_rig: CameraRig):
    source = openpose / "cam02_json" / "cam02.0038.json"
    shutil.copy(source, source.with_name("other.0038.json"))
    assert "frame 38: another file has the same frame number" in error_of(openpose, balance_rig, "body_25b")
    source.with_name("other.0038.json").rename(source.with_name("other.json"))
    assert "no frame number in the name 'other'" in error_of(openpose, balance_rig, "body_25b")


def test_numbers_that_are_not_frame_numbers(tmp_path: Path, rig: CameraRig):
    for camera in ("cam1", "cam2"):
        for frame in (0, 1, 1679059200):
            write_openpose(tmp_path, camera, frame)
    assert "not frame numbers" in error_of(tmp_path, rig)


def test_cameras_without_a_common_frame(tmp_path: Path, rig: CameraRig):
    write_openpose(tmp_path, "cam1", 1, flat(stick_px(0, 0), 1, 1, 1))
    write_openpose(tmp_path, "cam2", 2, flat(stick_px(0, 0), 1, 1, 1))
    assert "no frame number occurs in two cameras: cam_1 1-1, cam_2 2-2" in error_of(tmp_path, rig)


def test_cameras_that_do_not_match(openpose: Path, balance_rig: CameraRig):
    shutil.copytree(openpose / "cam01_json", openpose / "cam07_json")
    message = error_of(openpose, balance_rig.subset(["cam_01", "cam_02", "cam_03"]), "body_25b")
    assert "the calibration lacks camera cam04_json, cam07_json of the keypoints" in message
    shutil.rmtree(openpose / "cam07_json")
    shutil.rmtree(openpose / "cam02_json")
    message = error_of(openpose, balance_rig, "body_25b")
    assert "camera cam_02 of the calibration has no keypoints" in message
    assert "--cameras cam_01 cam_03 cam_04, in Python with rig.subset(['cam_01', 'cam_03', 'cam_04'])" in message
    rig = balance_rig.subset(["cam_04", "cam_01", "cam_03"])
    assert load_observations(openpose, rig, "body_25b", fps=60.0).camera_names == rig.names
    fewer = rig.subset(["cam_04", "cam_01"])
    seen = load_observations(openpose, fewer, "body_25b", fps=60.0, ignore_other_cameras=True)
    assert seen.camera_names == fewer.names


def test_the_calibration_of_other_cameras(openpose: Path, rig: CameraRig):
    for camera in ("cam02_json", "cam03_json", "cam04_json"):
        shutil.rmtree(openpose / camera)
    (openpose / "cam01_json").rename(openpose / "left_json")
    message = error_of(openpose, rig, "body_25b")
    assert "They have no camera in common: is it the calibration of this recording?" in message
    assert "rig.subset" not in message


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_a_folder_that_must_not_be_read_is_named(openpose: Path, balance_rig: CameraRig):
    (openpose / "cam02_json").chmod(0)
    try:
        with pytest.raises(PermissionError, match="cam02_json"):
            load_observations(openpose, balance_rig, "body_25b", fps=60.0)
    finally:
        (openpose / "cam02_json").chmod(0o755)


def test_cameras_that_cannot_be_told_apart(openpose: Path, balance_rig: CameraRig):
    shutil.copytree(openpose / "cam01_json", openpose / "Cam_01")
    assert "cannot be told apart" in error_of(openpose, balance_rig, "body_25b")


def test_options_are_checked(balance_rig: CameraRig):
    assert "frames per second (fps, or --fps)" in error_of(OPENPOSE, balance_rig, "body_25b", fps=None)
    assert "fps must be a number from 0.001 to 100000, got 0" in error_of(OPENPOSE, balance_rig, "body_25b", fps=0.0)
    assert "no person 5" in error_of(OPENPOSE, balance_rig, "body_25b", person=5)
    with pytest.raises(ValueError, match="no skeleton 'body_26'"):
        load_observations(OPENPOSE, balance_rig, "body_26", fps=60.0)


def test_a_folder_without_keypoints(tmp_path: Path, rig: CameraRig):
    assert "no keypoints; expected" in error_of(tmp_path, rig)
    for camera in ("cam1", "cam2"):
        write_openpose(tmp_path, camera, 0)
    write_json(tmp_path / "cam1.json", [])
    assert "a mixture of" in error_of(tmp_path, rig)


# One file per camera


def mmpose(frames: list[int], camera: int) -> dict[str, Any]:
    return {
        "meta_info": {},
        "instance_info": [
            {
                "frame_id": frame,
                "instances": [
                    {"keypoints": stick_px(frame, camera), "keypoint_scores": [0.5, 0.6, 0.7], "bbox": [[0, 0, 9, 9]]}
                ],
            }
            for frame in frames
        ],
    }


def coco(frames: list[int], camera: int) -> list[dict[str, Any]]:
    return [
        {"image_id": frame, "category_id": 1, "keypoints": flat(stick_px(frame, camera), 0.5, 0.6, 0.7), "score": 1.0}
        for frame in frames
    ]


@pytest.mark.parametrize("write", [mmpose, coco])
def test_mmpose_and_coco_results(tmp_path: Path, rig: CameraRig, write: Callable[[list[int], int], Any]):
    write_json(tmp_path / "cam_1.json", write([1, 2, 3], 0))
    write_json(tmp_path / "cam_2.json", write([1, 3], 1))
    observations = load_observations(tmp_path, rig, STICK, fps=10.0)
    np.testing.assert_allclose(observations.time_s, [0.1, 0.2, 0.3])
    np.testing.assert_allclose(observations.points2d_px[2], [stick_px(3, 0), stick_px(3, 1)])
    assert not observations.seen[1, 1].any()
    np.testing.assert_allclose(observations.confidence[0, 0], [0.5, 0.6, 0.7])


def test_coco_image_names_and_two_people(tmp_path: Path, rig: CameraRig):
    rows = coco([0, 0], 0)
    rows[0]["image_id"] = rows[1]["image_id"] = "frames/000012.jpg"
    rows[1]["keypoints"] = flat(stick_px(100, 0), 0.9, 0.9, 0.9)
    write_json(tmp_path / "cam_1.json", rows)
    write_json(tmp_path / "cam_2.json", coco([12], 1))
    second = load_observations(tmp_path, rig.subset(["cam_1", "cam_2"]), STICK, fps=10.0, person=1)
    np.testing.assert_allclose(second.points2d_px[0, 0], stick_px(100, 0))
    assert not second.seen[0, 1].any()
    np.testing.assert_allclose(second.time_s, [1.2])


def test_mmpose_on_images(tmp_path: Path, rig: CameraRig):
    instances = mmpose([5], 0)["instance_info"][0]["instances"]
    write_json(tmp_path / "cam_1" / "000005.json", instances)
    write_json(tmp_path / "cam_1" / "000006.json", [])
    write_json(tmp_path / "cam_2" / "000005.json", instances)
    observations = load_observations(tmp_path, rig, STICK, fps=10.0)
    assert observations.n_frames == 2
    np.testing.assert_allclose(observations.points2d_px[0, 0], stick_px(5, 0))


@pytest.mark.parametrize(
    ("document", "expected"),
    [
        ({"hello": 1}, ["not keypoints of"]),
        ([{"image_id": 3, "keypoints": [1, 2, 2] * 3}], ["frame 3", "joint hip", "[0, 1]: 2"]),
        ([{"image_id": 3, "keypoints": [1, 2, 1] * 4}], ["frame 3", "4 keypoints", "stick has 3 joints"]),
        ([{"image_id": 3, "keypoints": [1, 2, 1] * 3}, {"image_id": 4}], ["entry 1 lacks image_id or keypoints"]),
        ([{"image_id": "x", "keypoints": [1, 2, 1] * 3}], ["no frame number"]),
        ({"instance_info": [{"frame_id": 1}]}, ["entry 0 of instance_info"]),
        ({"instance_info": [{"frame_id": 1, "instances": [{}]}]}, ["frame 1", "without keypoints"]),
        (mmpose([1, 1], 0), ["frame 1", "twice"]),
        (openpose_image([1.0] * 9), ["OpenPose of a single image", "folder"]),
        ([{"poses2d": [[[1, 2]]]}], ["frame 0", "2D points", "3 joints of skeleton stick"]),
        ([{"poses2d": [[[1, 2]] * 3], "boxes": [[1]]}], ["frame 0", "boxes must be"]),
        ([{"poses2d": [1.0, 2.0]}], ["frame 0", "poses2d must be"]),
        ([{"poses2d": [[[1, 2]] * 3], "frame": None}], ["None is not the number of a frame"]),
        ({"poses2d": 3}, ["poses2d is not a list"]),
        ([{"poses2d": [[[1, 2]] * 3]}, {"poses3d": []}], ["frame 1", "poses2d is missing"]),
    ],
)
def test_a_bad_file_of_a_camera(tmp_path: Path, rig: CameraRig, document: Any, expected: list[str]):
    write_json(tmp_path / "cam_1.json", coco([3], 0))
    write_json(tmp_path / "cam_2.json", document)
    message = error_of(tmp_path, rig)
    for part in ("cam_2.json, camera cam_2", *expected):
        assert part in message


def test_a_mixture_of_formats_and_a_truncated_file(tmp_path: Path, rig: CameraRig):
    write_json(tmp_path / "cam_1.json", coco([1], 0))
    path = write_json(tmp_path / "cam_2.json", mmpose([1], 0))
    assert "a mixture of formats (cam_1: COCO results, cam_2: MMPose)" in error_of(tmp_path, rig)
    path.write_text(path.read_text()[:-20])
    assert "cam_2.json, camera cam_2: not JSON, or a truncated file" in error_of(tmp_path, rig)


def test_no_detection_at_all(tmp_path: Path, rig: CameraRig):
    for camera in ("cam_1", "cam_2"):
        write_json(tmp_path / f"{camera}.json", [])
    assert "no detection in any camera" in error_of(tmp_path, rig)


# MeTRAbs

WORLD_M = np.array([[0.1, 0.2, 0.3], [0.1, 0.6, 0.3], [0.1, 1.0, 0.3]])


def metrabs(camera: Camera, in_world: bool) -> dict[str, Any]:
    points_m = WORLD_M if in_world else camera.to_camera_frame(WORLD_M)
    return {
        "boxes": [[[0.0, 0, 100, 300, 0.8]]],
        "poses3d": [[(1000 * points_m).tolist()]],
        "poses2d": [[camera.project(WORLD_M).tolist()]],
    }


@pytest.mark.parametrize("frame", ["camera", "world"])
@pytest.mark.parametrize("form", ["npz", "columns", "rows"])
def test_metrabs(tmp_path: Path, rig: CameraRig, frame: Any, form: str):
    for camera in rig.cameras:
        columns = metrabs(camera, in_world=frame == "world")
        if form == "npz":
            np.savez(
                tmp_path / f"{camera.name}.npz", allow_pickle=False, **{k: np.array(v) for k, v in columns.items()}
            )
        else:
            rows = [{name: column[0] for name, column in columns.items()}, {"boxes": [], "poses3d": [], "poses2d": []}]
            write_json(tmp_path / f"{camera.name}.json", rows if form == "rows" else columns)
    observations = load_observations(tmp_path, rig, STICK, fps=10.0, points3d_frame=frame)
    assert observations.points3d_m is not None
    np.testing.assert_allclose(observations.points3d_m[0], [WORLD_M, WORLD_M], atol=1e-12)
    np.testing.assert_allclose(observations.points2d_px[0], rig.project(WORLD_M))
    np.testing.assert_allclose(observations.confidence[0], 0.8)
    assert observations.n_frames == (2 if form == "rows" else 1)


def test_metrabs_in_the_wrong_unit(tmp_path: Path, rig: CameraRig):
    for camera in rig.cameras:
        write_json(tmp_path / f"{camera.name}.json", metrabs(camera, in_world=True))
    assert "millimetres" in error_of(tmp_path, rig, points3d_unit="m", points3d_frame="world")


def test_metrabs_of_several_lengths(tmp_path: Path, rig: CameraRig):
    for camera in rig.cameras:
        columns = metrabs(camera, in_world=True)
        np.savez(tmp_path / f"{camera.name}.npz", poses2d=columns["poses2d"], boxes=np.zeros((2, 1, 5)))
    assert "cam_1.npz, camera cam_1: a different number of frames in poses2d 1, boxes 2" in error_of(tmp_path, rig)


# Our own files


def recording(own_clocks: bool = False, with_3d: bool = True) -> Observations:
    rng = np.random.default_rng(0)
    points2d_px = rng.uniform(0, 640, size=(6, 2, 3, 2))
    points2d_px[rng.random((6, 2, 3)) < 0.3] = np.nan
    points2d_px[4] = np.nan
    points3d_m = rng.normal(size=(6, 2, 3, 3))
    points3d_m[1, 1, 2] = np.nan
    time_s = np.arange(6) / 7
    if own_clocks:
        time_s = time_s[:, None] + np.array([0, 0.01])
        time_s[3, 1] = np.nan
    confidence = rng.uniform(0.1, 1, size=(6, 2, 3))
    root_m = rng.normal(scale=0.1, size=(6, 2, 3, 3, 3)) + 0.1 * np.eye(3)
    covariance_m2 = root_m @ root_m.swapaxes(-1, -2)
    if not with_3d:
        return Observations(STICK, time_s, points2d_px, confidence, camera_names=("cam_1", "cam_2"))
    return Observations(STICK, time_s, points2d_px, confidence, points3d_m, ("cam_1", "cam_2"), covariance_m2)


@pytest.mark.parametrize("extension", [".npz", ".parquet"])
@pytest.mark.parametrize("own_clocks", [False, True])
@pytest.mark.parametrize("with_3d", [False, True])
def test_round_trip(tmp_path: Path, rig: CameraRig, extension: str, own_clocks: bool, with_3d: bool):
    path = tmp_path / f"recording{extension}"
    original = recording(own_clocks, with_3d)
    save_observations(original, path)
    loaded = load_observations(path, rig, STICK)
    np.testing.assert_array_equal(loaded.time_s, original.time_s)
    # Single precision has 24 bits: 3e-5 px at 640 px, 3e-8 of a confidence, 2e-7 m at 3 m.
    np.testing.assert_allclose(loaded.points2d_px, original.points2d_px, atol=3e-5)
    np.testing.assert_allclose(loaded.confidence, original.confidence, atol=3e-8)
    assert (loaded.points3d_m is None) == (not with_3d)
    if loaded.points3d_m is not None and original.points3d_m is not None:
        np.testing.assert_allclose(loaded.points3d_m, original.points3d_m, atol=3e-7)
    assert (loaded.covariance3d_m2 is None) == (not with_3d)
    if loaded.covariance3d_m2 is not None and original.covariance3d_m2 is not None:
        np.testing.assert_allclose(loaded.covariance3d_m2, original.covariance3d_m2, atol=1e-8)
    save_observations(loaded, path)
    again = load_observations(path, rig, STICK)
    np.testing.assert_array_equal(again.points2d_px, loaded.points2d_px)
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("extension", [".npz", ".parquet"])
def test_our_own_files_follow_the_rig(tmp_path: Path, rig: CameraRig, extension: str):
    path = tmp_path / f"recording{extension}"
    original = recording()
    save_observations(original, path)
    turned = rig.subset(["cam_2", "cam_1"])
    loaded = load_observations(path, turned, STICK)
    assert loaded.camera_names == ("cam_2", "cam_1")
    np.testing.assert_allclose(loaded.points2d_px, original.points2d_px[:, ::-1], atol=3e-5)
    assert "has no keypoints" in error_of(path, CameraRig((*rig.cameras, _renamed(rig.cameras[0], "cam_3"))))
    assert "lacks camera cam_2" in error_of(path, rig.subset(["cam_1"]))
    alone = load_observations(path, rig.subset(["cam_2"]), STICK, ignore_other_cameras=True)
    np.testing.assert_array_equal(alone.points2d_px, loaded.points2d_px[:, :1])


def _renamed(camera: Camera, name: str) -> Camera:
    return Camera(name, camera.size_px, camera.K, camera.world_T_camera, camera.distortion)


@pytest.mark.parametrize("extension", [".npz", ".parquet"])
def test_our_own_files_of_another_skeleton(tmp_path: Path, rig: CameraRig, extension: str):
    path = tmp_path / f"recording{extension}"
    save_observations(recording(), path)
    message = error_of(path, rig, load_skeleton("coco_17"))
    assert "coco_17" in message
    assert "hip" in message


def test_a_long_table_of_other_programs(tmp_path: Path, rig: CameraRig):
    rows = [("cam 2", "knee", 8, 0.8, 10.0, 20.0, 0.5), ("cam 1", "hip", 7, 0.7, 30, 40, 0.6)]
    names = ("camera", "joint", "frame", "time_s", "x_px", "y_px", "confidence")
    table = pa.table(dict(zip(names, map(list, zip(*rows, strict=True)), strict=True)))
    path = tmp_path / "table.parquet"
    pq.write_table(table, path)
    observations = load_observations(path, rig, STICK)
    np.testing.assert_allclose(observations.time_s, [0.7, 0.8])
    assert np.argwhere(observations.seen).tolist() == [[0, 0, 0], [1, 1, 1]]
    np.testing.assert_allclose(observations.points2d_px[1, 1, 1], [10, 20])
    pq.write_table(pa.concat_tables([table, table]), path)
    assert "two rows for camera cam 1, joint hip, frame 7" in error_of(path, rig)
    pq.write_table(table.drop_columns(["x_px"]), path)
    assert "the column x_px is missing" in error_of(path, rig)
    pq.write_table(table.set_column(4, "x_px", pa.array(["a", "b"])), path)
    assert "column x_px does not contain numbers" in error_of(path, rig)


def test_save_refuses_other_extensions(tmp_path: Path):
    with pytest.raises(ValueError, match=r"a\.csv: observations are written as"):
        save_observations(recording(), tmp_path / "a.csv")
    assert not list(tmp_path.iterdir())


# What no detector writes


@pytest.mark.parametrize("odd", ["9" * 400, "9" * 5000, "[" * 100_000, '"1.5"', "{}", "NaN, [1]", "1e999"])
@pytest.mark.parametrize("kind", ["openpose", "coco", "metrabs"])
def test_odd_numbers_in_json_are_one_clear_error(tmp_path: Path, rig: CameraRig, kind: str, odd: str):
    point: list[Any] = ["ODD", *flat(stick_px(0, 0), 0.5, 0.6, 0.7)[1:]]
    documents = {
        "openpose": openpose_image(point),
        "coco": [{"image_id": 0, "keypoints": point}],
        "metrabs": {"poses2d": [[["ODD", 1.0], [1.0, 1.0], [1.0, 1.0]]]},
    }
    for camera in rig.names:
        path = tmp_path / (f"{camera}/0.json" if kind == "openpose" else f"{camera}.json")
        path.parent.mkdir(exist_ok=True)
        path.write_text(json.dumps(documents[kind]).replace('"ODD"', odd))
    with pytest.raises(ValueError, match=rf"{tmp_path}/cam_1.*json"):
        load_observations(tmp_path, rig, STICK, fps=10.0)


@pytest.mark.parametrize("name", ["9" * 5000, "x", "1" * 16])
def test_an_image_name_without_a_frame_number_is_refused(tmp_path: Path, rig: CameraRig, name: str):
    row = {"image_id": f"{name}.jpg", "keypoints": flat(stick_px(0, 0), 0.5, 0.6, 0.7)}
    path = write_json(tmp_path / "cam_1.json", [row])
    assert "cam_1.json, camera cam_1: no frame number" in error_of(path, rig)


def test_documents_of_one_format_in_the_shape_of_another_are_refused(tmp_path: Path, rig: CameraRig):
    path = write_json(tmp_path / "cam_1.json", [{"instance_info": []}])
    assert "not keypoints of MMPose" in error_of(path, rig)
    write_json(path, {"image_id": 0, "keypoints": []})
    assert "not keypoints of MMPose" in error_of(path, rig)


def test_the_cameras_of_keypoints_are_known_without_reading_them(tmp_path: Path, rig: CameraRig):
    write_openpose(tmp_path / "images", "cam_2", 0)
    write_openpose(tmp_path / "images", "cam_10", 0)
    assert keypoint_cameras(tmp_path / "images") == ("cam_2_json", "cam_10_json")
    write_json(tmp_path / "cameras" / "a.json", "nothing that could be read")
    assert keypoint_cameras(tmp_path / "cameras") == ("a",)
    assert keypoint_cameras(tmp_path / "cameras" / "a.json") == ("a",)
    seen = Observations(STICK, np.arange(2.0), np.ones((2, 2, 3, 2)), np.ones((2, 2, 3)), camera_names=rig.names)
    for extension in (".npz", ".parquet"):
        save_observations(seen, tmp_path / f"seen{extension}")
        assert keypoint_cameras(tmp_path / f"seen{extension}") == rig.names
