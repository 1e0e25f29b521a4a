from __future__ import annotations

import dataclasses
import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from scipy.spatial.transform import Rotation

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.io.calibration import load_quarter_turns, load_rig, save_rig

DATA = Path(__file__).parents[2] / "data"
QCA = DATA / "qualisys" / "Calib.qca.txt"
POSE2SIM = DATA / "qualisys" / "Calib_qualisys.toml"
WEBCAMS = DATA / "webcam_mediapipe" / "config.toml"
# A round trip through a rotation vector costs a few units in the last of 16 digits: 1e-12 px at 1000 px.
EXACT_PX = 1e-9


@pytest.fixture
def points_m() -> np.ndarray:
    return np.random.default_rng(0).uniform(-1, 1, size=(20, 3))


def camera_table(**changes: Any) -> dict[str, Any]:
    table = {
        "size": [640, 480],
        "matrix": [[500.0, 0, 320], [0, 500.0, 240], [0, 0, 1]],
        "distortions": [0.0] * 5,
        "rotation": [0.0, 0.0, 0.0],
        "translation": [0.0, 0.0, 4.0],
    }
    return {key: value for key, value in (table | changes).items() if value is not None}


def write_toml(folder: Path, document: dict[str, Any]) -> Path:
    path = folder / "calibration.toml"
    path.write_text(tomli_w.dumps(document))
    return path


def same_pixels(a: CameraRig, b: CameraRig, points_m: np.ndarray) -> bool:
    undistorted = np.nanmax(np.abs(a.project(points_m) - b.project(points_m)))
    lens = [
        np.nanmax(np.abs(x.distort(x.project(points_m)) - y.distort(y.project(points_m))))
        for x, y in zip(a.cameras, b.cameras, strict=True)
    ]
    return max(undistorted, *lens) < EXACT_PX


def test_pose2sim_toml_as_written_in_the_file():
    rig = load_rig(POSE2SIM)
    assert rig.names == ("cam_01", "cam_02", "cam_03", "cam_04")
    camera = rig.cameras[0]
    assert camera.size_px == (1088, 1920)
    # The file's rotation and translation take the camera's own position to its origin.
    table = tomllib.loads(POSE2SIM.read_text())["cam_01"]
    R = Rotation.from_rotvec(table["rotation"]).as_matrix()
    np.testing.assert_allclose(R @ camera.position_m + table["translation"], 0, atol=1e-12)


def test_qualisys_agrees_with_its_conversion_by_pose2sim(points_m: np.ndarray):
    qualisys, pose2sim = load_rig(QCA), load_rig(POSE2SIM)
    assert qualisys.names == ("cam01", "cam02", "cam03", "cam04")
    assert [camera.size_px for camera in qualisys.cameras] == [camera.size_px for camera in pose2sim.cameras]
    # Pose2Sim has divided the coefficients of the lens by 64, to the last digit.
    for own, theirs in zip(qualisys.cameras, pose2sim.cameras, strict=True):
        np.testing.assert_allclose(own.distortion, 64 * theirs.distortion, rtol=1e-9)
    assert same_pixels(without_distortion(qualisys), without_distortion(pose2sim), points_m)


def without_distortion(rig: CameraRig) -> CameraRig:
    return CameraRig(tuple(dataclasses.replace(camera, distortion=np.zeros(0)) for camera in rig.cameras))


def test_qualisys_leaves_marker_cameras_out(tmp_path: Path):
    path = tmp_path / "Calib.qca.txt"
    path.write_text(QCA.read_text().replace('model="none"', 'model="Miqus M3"', 1))
    assert load_rig(path).names == ("cam02", "cam03", "cam04")


def test_rotations_as_matrices():
    rig = load_rig(WEBCAMS)
    assert rig.names == ("cam_0", "cam_1", "cam_2", "cam_3")
    # Camera 1 is nearly the world frame, says the README of the recording.
    np.testing.assert_allclose(rig.cameras[1].world_T_camera, np.eye(4), atol=0.01)
    assert rig.cameras[0].distortion.size == 5


def test_the_format_is_recognised_by_the_content(tmp_path: Path):
    for source, name in ((QCA, "a.toml"), (POSE2SIM, "b.txt")):
        path = tmp_path / name
        path.write_bytes(source.read_bytes())
        assert load_rig(path).n_cameras == 4


def test_aniposelib_cameras_come_in_natural_order(tmp_path: Path):
    document = {f"cam_{i}": camera_table(name=f"cam_{i}", translation=[0.1 * i, 0, 4]) for i in (10, 2, 1)}
    rig = load_rig(write_toml(tmp_path, {**document, "metadata": {"error": 0.1}}))
    assert rig.names == ("cam_1", "cam_2", "cam_10")
    np.testing.assert_allclose(rig.cameras[2].position_m, [-1, 0, -4])


@pytest.mark.parametrize(("scale", "unit"), [(1.0, "auto"), (1000.0, "auto"), (1000.0, "mm"), (1.0, "m")])
def test_aniposelib_unit(tmp_path: Path, scale: float, unit: Any):
    document = {f"cam_{i}": camera_table(translation=[i * scale, 0, 4 * scale]) for i in range(2)}
    rig = load_rig(write_toml(tmp_path, document), unit=unit)
    np.testing.assert_allclose(rig.cameras[1].position_m, [-1, 0, -4])


def test_aniposelib_of_ambiguous_size_asks_for_the_unit(tmp_path: Path):
    path = write_toml(tmp_path, {f"cam_{i}": camera_table(translation=[i, 0, 60]) for i in range(2)})
    with pytest.raises(ValueError, match=rf"{path.name}: .*give --unit m, cm or mm, in Python unit=.mm"):
        load_rig(path)
    np.testing.assert_allclose(load_rig(path, unit="m").cameras[0].position_m, [0, 0, -60])


def test_caliscope_nested_tables(tmp_path: Path):
    document = {
        "cameras": {
            "10": camera_table(ignore=False),
            "2": camera_table(translation=[0.5, 0, 4], rotation=np.eye(3).tolist()),
            "3": camera_table(ignore=True),
        }
    }
    rig = load_rig(write_toml(tmp_path, document))
    assert rig.names == ("cam_2", "cam_10")
    np.testing.assert_allclose(rig.cameras[0].position_m, [-0.5, 0, -4])


INTRI = """%YAML:1.0
---
names:
   - "01"
   - "02"
K_01: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 500., 0., 320., 0., 510., 240., 0., 0., 1. ]
dist_01: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ 0.1, 0.01, 0., 0., 0. ]
H_01: 480
W_01: 641
K_02: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 500., 0., 320., 0., 510., 240., 0., 0., 1. ]
D_02: !!opencv-matrix
   rows: 1
   cols: 4
   dt: d
   data: [ 0., 0., 0., 0. ]
"""
EXTRI = """%YAML:1.0
---
names:
   - "01"
   - "02"
R_01: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [ 0., 0., 1.5707963267948966 ]
Rot_01: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 0., -1., 0., 1., 0., 0., 0., 0., 1. ]
T_01: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [ 1., 2., 3. ]
R_02: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [ 0., 0., 1.5707963267948966 ]
T_02: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [ 1., 2., 3. ]
"""


@pytest.fixture
def easymocap(tmp_path: Path) -> Path:
    (tmp_path / "intri.yml").write_text(INTRI)
    (tmp_path / "extri.yml").write_text(EXTRI)
    return tmp_path


@pytest.mark.parametrize("given", ["", "intri.yml", "extri.yml"])
def test_easymocap(easymocap: Path, given: str):
    rig = load_rig(easymocap / given)
    assert rig.names == ("01", "02")
    # The second camera has no size in the file: twice its principal point.
    assert [camera.size_px for camera in rig.cameras] == [(641, 480), (640, 480)]
    assert [camera.distortion.size for camera in rig.cameras] == [5, 4]
    for camera in rig.cameras:
        # x_camera = R x + t with a quarter turn about z: the origin of the world is at t, x goes to y.
        np.testing.assert_allclose(camera.to_camera_frame(np.array([[0.0, 0, 0], [1, 0, 0]])), [[1, 2, 3], [1, 3, 3]])


@pytest.mark.parametrize("broken", ["intri.yml", "extri.yml"])
@pytest.mark.parametrize("content", [None, "", "%YAML:1.0\n---\nK_01: !!opencv-matrix\n   rows: 3\n   co"])
def test_easymocap_damaged(easymocap: Path, broken: str, content: str | None):
    if content is None:
        (easymocap / broken).unlink()
    else:
        (easymocap / broken).write_text(content)
    with pytest.raises(ValueError, match=broken):
        load_rig(easymocap)


def test_easymocap_names_the_camera_that_lacks_something(easymocap: Path):
    (easymocap / "extri.yml").write_text(EXTRI[: EXTRI.index("T_02")])
    with pytest.raises(ValueError, match=r"camera 02: T_02 is missing"):
        load_rig(easymocap)
    (easymocap / "extri.yml").write_text(EXTRI.replace('   - "02"\n', ""))
    with pytest.raises(ValueError, match=r"camera 02 is in one of intri\.yml and extri\.yml only"):
        load_rig(easymocap)


@pytest.mark.parametrize("extension", [".npz", ".toml"])
@pytest.mark.parametrize(
    ("lens", "distortion"),
    [
        ("pinhole", []),
        ("pinhole", [-0.2, 0.05, 1e-3, -1e-3]),
        ("pinhole", [-0.2, 0.05, 1e-3, -1e-3, 0.01]),
        ("pinhole", [-0.2, 0.05, 1e-3, -1e-3, 0.01, 0.1, -0.02, 0.003]),
        ("fisheye", [0.05, -0.01, 0.002, -0.001]),
    ],
)
def test_round_trip(tmp_path: Path, points_m: np.ndarray, extension: str, lens: Any, distortion: list[float]):
    K = np.array([[800.0, 0, 400], [0, 810, 300], [0, 0, 1]])
    rotations = Rotation.random(3, rng=np.random.default_rng(0)).as_matrix()
    rig = CameraRig(
        tuple(
            Camera.from_world_to_camera(name, (800, 600), K, R, np.array([0.1, -0.2, 5]), distortion, lens)
            for name, R in zip(("left", "cam_10", "cam_2"), rotations, strict=True)
        )
    ).with_time_offsets(np.array([0.0, 0.0123, -0.05]))
    path = tmp_path / f"rig{extension}"
    save_rig(rig, path)
    loaded = load_rig(path)
    assert loaded.names == rig.names
    assert [camera.lens for camera in loaded.cameras] == [lens] * 3
    np.testing.assert_array_equal(loaded.time_offsets_s, rig.time_offsets_s)
    assert same_pixels(loaded, rig, points_m)
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


def test_save_rig_refuses_other_extensions(tmp_path: Path):
    with pytest.raises(ValueError, match=r"rig\.yml: a rig is written as \.npz or \.toml"):
        save_rig(load_rig(POSE2SIM), tmp_path / "rig.yml")


def test_millimetres_where_metres_are_meant(tmp_path: Path):
    path = tmp_path / "Calib.toml"
    path.write_text(
        re.sub(
            r"translation = \[(.*)\]",
            lambda match: f"translation = [{', '.join(str(1000 * float(x)) for x in match[1].split(','))}]",
            POSE2SIM.read_text(),
        )
    )
    with pytest.raises(ValueError, match=r"Calib\.toml: camera cam_0\d is \d+ m .*not metres; give --unit mm"):
        load_rig(path)
    np.testing.assert_allclose(
        load_rig(path, unit="mm").cameras[0].position_m, load_rig(POSE2SIM).cameras[0].position_m
    )


def test_metres_read_as_millimetres():
    with pytest.raises(ValueError, match=r"Calib_qualisys\.toml: all cameras lie within .* give --unit m"):
        load_rig(POSE2SIM, unit="mm")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"rotation": [[1.0, 0, 0], [0, 1, 0], [0, 0, 2]]}, "camera cam_1: the rotation is not a rotation matrix"),
        ({"rotation": [1.0, 0.0]}, "camera cam_1: a rotation has 3 numbers"),
        ({"matrix": [[0.0, 0, 320], [0, 500, 240], [0, 0, 1]]}, "camera cam_1: K is singular"),
        ({"matrix": [[500.0, 0], [0, 500]]}, "camera cam_1: matrix must have 3 x 3 numbers, got 4"),
        ({"matrix": "none"}, "camera cam_1: matrix is not an array of numbers"),
        ({"translation": [0.0, float("nan"), 4.0]}, "camera cam_1: translation contains a number that is not finite"),
        ({"translation": None}, "camera cam_1: translation is missing"),
        ({"size": None}, "camera cam_1: size is missing"),
        ({"distortions": [0.0] * 3}, "camera cam_1: a pinhole lens takes 0, 4, 5, 8 coefficients, got 3"),
    ],
)
def test_an_impossible_camera_is_named_with_its_file(tmp_path: Path, changes: dict[str, Any], message: str):
    path = write_toml(tmp_path, {"cam_0": camera_table(), "cam_1": camera_table(**changes)})
    with pytest.raises(ValueError, match=re.escape(f"{path}: {message}")):
        load_rig(path)


@pytest.mark.parametrize("source", [POSE2SIM, QCA])
@pytest.mark.parametrize("content", ["empty", "truncated", "garbage", "prose", "other"])
def test_a_damaged_file_is_named(tmp_path: Path, source: Path, content: str):
    whole = source.read_bytes()
    contents = {
        "empty": b" \n",
        "truncated": whole[:700],
        "garbage": np.random.default_rng(0).bytes(500),
        "prose": b"these are not the cameras",
        "other": b"[tool]\nx = 1\n" if source == POSE2SIM else b"<html></html>",
    }
    path = tmp_path / "broken.file"
    path.write_bytes(contents[content])
    with pytest.raises(ValueError, match=r"broken\.file: ") as error:
        load_rig(path)
    assert str(error.value).count("broken.file") == 1


@pytest.mark.parametrize("keep", [10, 300, -100])
def test_a_damaged_npz_is_named(tmp_path: Path, keep: int):
    path = tmp_path / "rig.npz"
    save_rig(load_rig(POSE2SIM), path)
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(ValueError, match=r"rig\.npz: a damaged npz"):
        load_rig(path)


def test_an_npz_of_something_else_is_named(tmp_path: Path):
    np.savez(tmp_path / "rig.npz", K=np.eye(3))
    with pytest.raises(ValueError, match=r"rig\.npz: not a calibration .*camera_names"):
        load_rig(tmp_path / "rig.npz")


def test_qualisys_names_the_camera_that_lacks_something(tmp_path: Path):
    path = tmp_path / "Calib.qca.txt"
    path.write_text(re.sub(r'focalLengthV="107123[^"]*"', "", QCA.read_text()))
    with pytest.raises(ValueError, match=r"qca\.txt: camera cam02: intrinsic has no number focalLengthV"):
        load_rig(path)


def test_easymocap_with_a_wrong_number_of_rows(easymocap: Path):
    (easymocap / "extri.yml").write_text(EXTRI.replace("rows: 3", "rows: 93"))
    assert load_rig(easymocap).n_cameras == 2
    (easymocap / "extri.yml").write_text(EXTRI.replace("[ 1., 2., 3. ]", "[ 1., 2. ]"))
    with pytest.raises(ValueError, match="camera 01: T must have 3 numbers, got 2"):
        load_rig(easymocap)


def test_an_unknown_unit_is_refused():
    for unit in ("km/h", "0", "-1", "nan"):
        with pytest.raises(ValueError, match=rf"unit must be auto, m, .* how many metres it is .*got '{unit}'"):
            load_rig(POSE2SIM, unit=unit)


@pytest.mark.parametrize(
    ("unit", "metres"), [("cm", 0.01), ("inch", 0.0254), ("dm", 0.1), ("0.054", 0.054), (0.03, 0.03)]
)
def test_any_unit_is_converted(tmp_path: Path, unit: str | float, metres: float):
    document = {f"cam_{i}": camera_table(translation=[i / metres, 0, 4 / metres]) for i in range(2)}
    np.testing.assert_allclose(load_rig(write_toml(tmp_path, document), unit=unit).cameras[1].position_m, [-1, 0, -4])


def test_toml_of_synchronous_cameras_has_nothing_that_other_programs_do_not_know(tmp_path: Path):
    path = tmp_path / "rig.toml"
    rig = load_rig(POSE2SIM)
    save_rig(rig, path)
    tables = tomllib.loads(POSE2SIM.read_text())
    assert {name: set(table) for name, table in tomllib.loads(path.read_text()).items()} == {
        name: set(table) for name, table in tables.items()
    }
    save_rig(rig.with_time_offsets(np.array([0.0, 0.01, 0.0, 0.0])), path)
    assert [table.get("time_offset_s") for table in tomllib.loads(path.read_text()).values()][:4] == [
        None,
        0.01,
        None,
        None,
    ]


def test_an_npz_from_before_time_offsets_is_read(tmp_path: Path):
    path = tmp_path / "rig.npz"
    save_rig(load_rig(POSE2SIM).with_time_offsets(np.full(4, 0.01)), path)
    with np.load(path) as archive:
        old = {name: archive[name] for name in archive.files if name != "time_offset_s"}
    np.savez(path, **old)
    np.testing.assert_array_equal(load_rig(path).time_offsets_s, np.zeros(4))


@pytest.mark.parametrize("offset", [float("nan"), "late", [0.1, 0.2]])
def test_an_impossible_time_offset_is_named(tmp_path: Path, offset: Any):
    path = write_toml(tmp_path, {"cam_0": camera_table(), "cam_1": camera_table(time_offset_s=offset)})
    with pytest.raises(ValueError, match=r"calibration\.toml: camera cam_1: time_offset_s"):
        load_rig(path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("[" * 100_000, "intri.yml is damaged or not OpenCV YAML"),
        ("{" * 100_000, "intri.yml is damaged or not OpenCV YAML"),
        ("- " * 100_000, "intri.yml is damaged or not OpenCV YAML"),
        (INTRI.replace("names:", "names: &n").replace("H_01: 480", "H_01: *n"), "intri.yml .* it has an alias"),
        (INTRI.replace("H_01: 480", "H_01: 1e400"), "camera 01: the image size contains a number that is not finite"),
        (INTRI.replace("H_01: 480", "H_01: [480]"), "camera 01: the image size has something that is not a number"),
        (INTRI.replace("500., 0., 320.", ".Nan, 0., 320."), "camera 01: K has something that is not a number: '.Nan'"),
        ("# nothing" * 200_000, "intri.yml is damaged .*it has more than 1000000 bytes"),
        ("\x00", "intri.yml is damaged"),
        ("- 1", "intri.yml is empty or not OpenCV YAML"),
    ],
)
def test_a_damaged_easymocap_file_is_one_clear_error(easymocap: Path, content: str, message: str):
    head = "" if content.startswith("%YAML") else "%YAML:1.0\n---\n"
    (easymocap / "intri.yml").write_text(head + content)
    with pytest.raises(ValueError, match=message):
        load_rig(easymocap)


def test_easymocap_with_the_directive_of_yaml_and_names_without_quotes(easymocap: Path):
    intri = INTRI.replace("%YAML:1.0", "%YAML 1.0").replace('"', "").replace("D_02: !!opencv-matrix", "D_02:")
    (easymocap / "intri.yml").write_text(intri, encoding="utf-8-sig")
    assert load_rig(easymocap).names == ("01", "02")


def test_numbers_as_opencv_itself_writes_them(easymocap: Path, points_m: np.ndarray):
    import cv2

    expected = load_rig(easymocap)
    for name, suffix in (("intri.yml", "K"), ("extri.yml", "T")):
        before = cv2.FileStorage(str(easymocap / name), cv2.FILE_STORAGE_READ)
        after = cv2.FileStorage(str(easymocap / f"new_{name}"), cv2.FILE_STORAGE_WRITE)
        after.write("names", ["01", "02"])
        keys = set(before.root().keys()) - {"names"}
        assert f"{suffix}_01" in keys
        for key in keys:
            node = before.getNode(key)
            after.write(key, node.mat() if node.isMap() else node.real())
        before.release()
        after.release()
        (easymocap / f"new_{name}").replace(easymocap / name)
    assert same_pixels(load_rig(easymocap), expected, points_m)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("[[500.0, 0", "[[" + "9" * 400 + ", 0"),
        ("[[500.0, 0", "[[" + "9" * 5000 + ", 0"),
        ("translation", "a." * 20_000 + "translation"),
        ("[0.0, 0.0, 4.0]", "[" * 100_000),
        ("[0.0, 0.0, 4.0]", "2020-02-30"),
        ("[640, 480]", "[inf, 480]"),
    ],
)
def test_what_toml_can_hold_and_a_calibration_cannot(tmp_path: Path, old: str, new: str):
    path = write_toml(tmp_path, {"cam_0": camera_table(), "cam_1": camera_table()})
    text = re.sub(r",?\n(?=\])|\n +", "", path.read_text()).replace(",", ", ")
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(ValueError, match=r"calibration\.toml: "):
        load_rig(path)


def test_a_qualisys_number_that_is_not_finite_is_named(tmp_path: Path):
    path = tmp_path / "Calib.qca.txt"
    path.write_text(re.sub(r'(<fov_video [^>]*right=)"[^"]*"', r'\1"inf"', QCA.read_text()))
    with pytest.raises(ValueError, match=r"qca\.txt: camera cam01: fov_video has no number right, but 'inf'"):
        load_rig(path)


@pytest.mark.parametrize(
    ("name", "array", "message"),
    [
        ("size_px", np.full((4, 2), np.inf), "camera cam_01: size_px contains a number that is not finite"),
        ("K", np.full((4, 3, 3), "x"), "array K must be numbers"),
        ("K", np.zeros((4, 3)), r"array K must be \(4, 3, 3\), got \(4, 3\)"),
        ("camera_names", np.arange(4), "array camera_names must be texts"),
        ("lens", np.array(["pinhole"]), "4 cameras have 1 lenses"),
    ],
)
def test_an_npz_member_of_another_kind_is_named(tmp_path: Path, name: str, array: np.ndarray, message: str):
    path = tmp_path / "rig.npz"
    save_rig(load_rig(POSE2SIM), path)
    with np.load(path) as archive:
        members = dict(archive)
    np.savez(path, **(members | {name: array}))
    with pytest.raises(ValueError, match=rf"rig\.npz: .*{message}"):
        load_rig(path)


def test_cameras_that_caliscope_has_not_placed_are_left_out_by_name(tmp_path: Path):
    lost = camera_table() | {"rotation": "null", "translation": "null"}
    document = {"cameras": {"0": camera_table(), "1": camera_table(translation=[1, 0, 4]), "2": lost}}
    with pytest.warns(
        UserWarning,
        match=r"calibration\.toml: camera cam_2 has no pose: caliscope has not placed it, and it is left out",
    ):
        rig = load_rig(write_toml(tmp_path, document))
    assert rig.names == ("cam_0", "cam_1")
    path = write_toml(tmp_path, {"cameras": {"0": lost}})
    with pytest.raises(ValueError, match="no camera has a pose: calibrate the extrinsics in caliscope"):
        load_rig(path)


def test_quarter_turns_of_caliscope(tmp_path: Path):
    """The recorded calibration beside this test has such cameras, and keypoints of the images as recorded."""
    assert load_quarter_turns(WEBCAMS) == {"cam_1": -1, "cam_2": 1}
    assert load_quarter_turns(POSE2SIM) == load_quarter_turns(QCA) == {}


def test_a_rig_that_is_too_large_names_the_units_that_fit(tmp_path: Path):
    """Squares of 54 mm, read as metres: 8 m are 148."""
    document = {f"cam_{i}": camera_table(translation=[i / 0.054, 0, 8 / 0.054]) for i in range(3)}
    said = r"these are not metres; give --unit cm \(then it measures 1\.5 m\), or how many metres a unit is"
    with pytest.raises(ValueError, match=said):
        load_rig(write_toml(tmp_path, document), unit="m")
